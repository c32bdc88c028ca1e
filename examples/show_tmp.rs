fn main() {
    let args: Vec<String> = std::env::args().collect();
    let out = &args[1];
    for file in &args[2..] {
        let path = std::path::Path::new(file);
        let scenario = match stopline::io::commonroad::read_file(path) {
            Ok(s) => s,
            Err(e) => {
                eprintln!("{e}");
                continue;
            }
        };
        let vehicle = stopline::vehicle::load("bmw_320i").unwrap();
        let settings = stopline::drive::Settings::default();
        let start = std::time::Instant::now();
        let run =
            stopline::drive::drive(&scenario, &scenario.problems[0], &vehicle, &settings, &mut |_, _| {}).unwrap();
        let stem = path.file_stem().unwrap().to_string_lossy().to_string();
        let drove = start.elapsed().as_secs_f64();
        let t = std::time::Instant::now();
        let svg = stopline::plot::run_svg(&run);
        let t_svg = t.elapsed().as_secs_f64();
        std::fs::write(format!("{out}/{stem}.svg"), &svg).unwrap();
        let t = std::time::Instant::now();
        #[cfg(feature = "rerun")]
        stopline::recording::write(&run, std::path::Path::new(&format!("{out}/{stem}.rrd"))).unwrap();
        let size = std::fs::metadata(format!("{out}/{stem}.rrd")).map(|m| m.len()).unwrap_or(0);
        println!(
            "{stem}: {} {:?} {} drive {drove:.2}s svg {t_svg:.3}s {}kB rrd {:.3}s {}kB obstacles {}",
            run.outcome.name(),
            run.reason,
            run.verdict.pass(),
            svg.len() / 1000,
            t.elapsed().as_secs_f64(),
            size / 1000,
            scenario.obstacles.len()
        );
    }
}

#![allow(missing_docs)]
use stopline::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let sc = io::commonroad::read_file(std::path::Path::new(&a[1])).unwrap();
    let v = vehicle::load("bmw_320i").unwrap();
    let s = drive::Settings::default();
    let t = std::time::Instant::now();
    let run = drive::drive(&sc, &sc.problems[0], &v, &s, &mut |_, _| {}).unwrap();
    println!("{} {} {:?} cycles {} in {:.2}s", sc.id, run.outcome.name(), run.reason, run.cycles.len(), t.elapsed().as_secs_f64());
    for c in &run.verdict.checks { println!("  {} {} {:.3} / {:.3} {} at {:?} {}", if c.pass {"ok  "} else {"FAIL"}, c.name, c.value, c.limit, c.unit, c.at_time, c.note); }
    if a.len() > 2 { for c in run.cycles.iter().step_by(5) { let k = c.committed.profile.at(c.time - c.committed.start_time); println!("t {:.1} {:?} v {:.2} a {:.2} rest in {:.1} cand {} exp {} total {:.1} ms lat {:.1} spd {:.1} smo {:.1} rej {:?}", c.time, c.decision, k.speed, k.acceleration, c.committed.profile.last().station - k.station, c.candidates.len(), c.expansions, c.stage_seconds.total*1e3, c.stage_seconds.lattice*1e3, c.stage_seconds.speed*1e3, c.stage_seconds.smoothing*1e3, c.candidates.iter().filter_map(|x| x.rejected).collect::<Vec<_>>()); } 
    std::fs::write("/tmp/run.svg", plot::run_svg(&run)).unwrap(); }
}

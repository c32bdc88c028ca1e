use super::*;
use crate::geometry::spiral::connect;
use crate::geometry::spiral::lattice_problems;

#[test]
fn spike() {
    let bound = 0.12;
    for (name, k) in [("soft", 0), ("quintic", 1), ("soft bite", 2), ("quintic bite", 3)] {
        let mut count = std::collections::BTreeMap::<String, usize>::new();
        let (mut iters, mut programs, mut n) = (0, 0, 0);
        let mut times = Vec::new();
        for always in [false, true] {
            let mut local = Vec::new();
            for (start, end, curvature) in lattice_problems(2000) {
                let Ok(free) = connect(start, &end, curvature) else { continue };
                if k >= 2 && free.max_abs_curvature() <= bound {
                    continue;
                }
                let mut problem = Problem::pinned(start, end, curvature);
                problem.always_convex = always;
                if k == 0 || k == 2 {
                    problem.across = EndCondition::Soft { weight: if k == 0 { 0.01 } else { 100.0 } };
                }
                if k >= 2 {
                    problem.max_curvature = bound;
                }
                let t = std::time::Instant::now();
                let (status, i, p, r, method) = if k % 2 == 0 {
                    let s = problem.cubic();
                    (s.status, s.iterations, s.programs, s.residual, s.method)
                } else {
                    let s = problem.quintic();
                    (s.status, s.iterations, s.programs, s.residual, s.method)
                };
                local.push(t.elapsed().as_secs_f64() * 1e6);
                *count.entry(format!("{status:?} {method:?} {}", r < 1e-9)).or_default() += 1;
                iters += i;
                programs += p;
                n += 1;
            }
            local.sort_by(f64::total_cmp);
            times.push((local[local.len() / 2], local[local.len() * 99 / 100]));
        }
        println!(
            "{name}: {count:?} iterations {:.2} programs {:.2} {times:?}",
            iters as f64 / n as f64,
            programs as f64 / n as f64
        );
    }
}

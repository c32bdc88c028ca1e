//! Reproducible random lattice problems for comparisons, benches and tests.

use crate::geometry::Pose;

/// Seed of the problems in the documentation.
pub const SEED: u64 = 7;
/// Number of problems in the documentation.
pub const COUNT: usize = 2000;

/// A boundary-value problem: a path from the origin with heading 0 to `end`, with given curvatures at both ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticeProblem {
    /// Curvature at the start, 1/m.
    pub start_curvature: f64,
    /// Pose of the end in the start frame.
    pub end: Pose,
    /// Curvature at the end, 1/m.
    pub end_curvature: f64,
}

/// Uniformly distributed problems in the range of a lattice on a road: 10…40 m longitudinally, ±8 m laterally, ±0.5
/// rad, ±0.1 1/m of curvature at both ends. The first `n` problems of a seed do not depend on `count`. Generator:
/// splitmix64 (Steele, Lea and Flood, 2014).
#[must_use]
pub fn lattice_problems(seed: u64, count: usize) -> Vec<LatticeProblem> {
    let mut state = seed;
    let mut uniform = move |low: f64, high: f64| {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    };
    let problem = |_| {
        let end = Pose::new(uniform(10.0, 40.0), uniform(-8.0, 8.0), uniform(-0.5, 0.5));
        LatticeProblem { start_curvature: uniform(-0.1, 0.1), end, end_curvature: uniform(-0.1, 0.1) }
    };
    (0..count).map(problem).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_of_a_seed_never_change() {
        let problems = lattice_problems(SEED, 3);
        let expected = [
            (0.016586058605615614, (21.694892451738145, -7.731387287549502, 0.4007606806068834), -0.009511620997706333),
            (-0.07314834023831028, (17.4829456684823, -0.5127519324340248, -0.1719232608474971), -0.01737172051644413),
            (0.07426635197534878, (13.106798420350355, 7.357985225169465, 0.41801958514613236), 0.07280153245871976),
        ];
        let expected = expected.map(|(start_curvature, (x, y, yaw), end_curvature)| LatticeProblem {
            start_curvature,
            end: Pose::new(x, y, yaw),
            end_curvature,
        });
        assert_eq!(problems, expected);
        assert_eq!(lattice_problems(SEED, 2), problems[..2]);
        assert_ne!(lattice_problems(8, 3), problems);
    }

    #[test]
    fn problems_fill_their_ranges() {
        let problems = lattice_problems(1, 5000);
        /// A quantity with its range.
        type Field = (fn(&LatticeProblem) -> f64, f64, f64);
        let fields: [Field; 5] = [
            (|p| p.end.position.x, 10.0, 40.0),
            (|p| p.end.position.y, -8.0, 8.0),
            (|p| p.end.yaw, -0.5, 0.5),
            (|p| p.start_curvature, -0.1, 0.1),
            (|p| p.end_curvature, -0.1, 0.1),
        ];
        for (field, low, high) in fields {
            let (least, most) =
                problems.iter().map(field).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let slack = 0.01 * (high - low);
            assert!(low <= least && least < low + slack && high - slack < most && most <= high, "{least} {most}");
        }
    }
}

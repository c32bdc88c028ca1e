//! Random lattice problems, the same wherever they are asked for: this program's comparisons, benches and tests.

use crate::geometry::Pose;

/// The seed whose problems the published figures are about.
pub const SEED: u64 = 7;
/// How many of them.
pub const COUNT: usize = 2000;

/// A path to find: from the origin with heading 0 to `end`, with the curvatures at both ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticeProblem {
    /// Curvature at the start, 1/m.
    pub start_curvature: f64,
    /// Pose of the end in the start's frame.
    pub end: Pose,
    /// Curvature at the end, 1/m.
    pub end_curvature: f64,
}

/// Problems as a lattice on a road has them, evenly distributed: 10…40 m ahead, ±8 m across, ±0.5 rad, curvatures at both
/// ends within ±0.1 1/m. The first `n` of a seed are the same for every count. Generator: splitmix64 (Steele, Lea & Flood
/// 2014), seeded with `seed`.
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
    fn problems_stay_what_they_were() {
        let problems = lattice_problems(SEED, 3);
        let older = crate::geometry::spiral::lattice_problems(3);
        for (p, (start, end, curvature)) in problems.iter().zip(older) {
            assert_eq!((p.start_curvature, p.end, p.end_curvature), (start, end, curvature));
        }
        assert_eq!(lattice_problems(SEED, 2), problems[..2]);
        assert_ne!(lattice_problems(8, 3), problems);
    }

    #[test]
    fn problems_fill_their_ranges_and_nothing_beyond() {
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

//! Spirals under a curvature bound whose end may slide sideways: [`super::boundary`] as the lattice uses it.
//!
//! With position, heading and curvature fixed at both ends a cubic spiral is determined ([`connect`]) and has no freedom
//! to optimise. If that spiral exceeds the curvature bound, the end may slide sideways:
//!
//! ```text
//! minimise    ∫ κ² ds + w e²                   over the inner knots k₁, k₂, the length L and the slide e
//! subject to  end(k₁, k₂, L) = target + e · (left of the target's heading),   heading exact
//!             |κ(u)| ≤ κ_max  for all u in [0, 1]
//! ```
//!
//! Weak: the method is local. It returns [`SpiralFailure::CurvatureBound`] for some ends that would have to slide by more
//! than about five metres although a spiral exists.

use super::Pose;
use super::boundary::{EndCondition, Infeasibility, Problem, Status};
use super::spiral::{CubicSpiral, SpiralFailure, connect};

/// The method that solved for a spiral.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Newton's method: all end conditions are met.
    Newton,
    /// The convex program: the end slid sideways to respect the bound.
    Convex,
}

/// A spiral within a curvature bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundedSpiral {
    /// The spiral; its largest |curvature| is within the bound everywhere.
    pub spiral: CubicSpiral,
    /// The method that solved for it.
    pub method: Method,
    /// Lateral offset of the end from the requested end, m, positive to the left; 0 for [`Method::Newton`].
    pub end_error: f64,
}

/// Weight w of the slide against bending energy, 1/m³: a centimetre costs as much as 10 m driven at a curvature of
/// 1/30 m⁻¹, so that the end stays as near to the requested end as the bound allows.
const SLIDE_WEIGHT: f64 = 100.0;

/// Solves for the spiral from the origin with heading 0 and `start_curvature` (1/m) to `end` (in that frame) with
/// `end_curvature` (1/m) and |curvature| ≤ `max_curvature` (1/m) everywhere. Tries Newton's method first and checks the
/// curvature in closed form; if the bound is active, the end slides sideways as little as needed.
///
/// # Errors
/// [`SpiralFailure`]; [`SpiralFailure::CurvatureBound`] if an end curvature exceeds the bound or no spiral respects it.
pub fn connect_bounded(
    start_curvature: f64,
    end: &Pose,
    end_curvature: f64,
    max_curvature: f64,
) -> Result<BoundedSpiral, SpiralFailure> {
    let free = connect(start_curvature, end, end_curvature);
    if !(start_curvature.abs() <= max_curvature && end_curvature.abs() <= max_curvature) {
        return Err(SpiralFailure::CurvatureBound);
    }
    match free {
        Ok(spiral) if spiral.max_abs_curvature() <= max_curvature => {
            return Ok(BoundedSpiral { spiral, method: Method::Newton, end_error: 0.0 });
        }
        Ok(_) | Err(SpiralFailure::NotConverged) => {}
        Err(failure) => return Err(failure),
    }
    let slid = Problem {
        lateral: EndCondition::Soft { weight: SLIDE_WEIGHT },
        max_curvature,
        ..Problem::pinned(start_curvature, *end, end_curvature)
    }
    .cubic();
    match slid.status {
        Status::Solved | Status::BoundActive => {
            Ok(BoundedSpiral { spiral: slid.spiral, method: Method::Convex, end_error: slid.deviation.lateral })
        }
        Status::IterationLimit => Err(SpiralFailure::NotConverged),
        Status::Infeasible(Infeasibility::Invalid) => Err(SpiralFailure::NotFinite),
        Status::Infeasible(Infeasibility::Coincident) => Err(SpiralFailure::Coincident),
        Status::Infeasible(Infeasibility::Behind) => Err(SpiralFailure::Behind),
        Status::Infeasible(_) => Err(SpiralFailure::CurvatureBound),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::spiral::lattice_problems;

    const ORIGIN: Pose = Pose { position: super::super::Point::new(0.0, 0.0), yaw: 0.0 };

    #[test]
    fn uses_newton_where_the_bound_is_inactive() {
        let end = Pose::new(20.0, 1.0, 0.0);
        let bounded = connect_bounded(0.0, &end, 0.0, 0.2).unwrap();
        assert_eq!(bounded.method, Method::Newton);
        assert_eq!(bounded.spiral, connect(0.0, &end, 0.0).unwrap());
        assert_eq!(bounded.end_error, 0.0);
    }

    /// The smallest slide within the bound, by bisection over Newton's spirals: slow and independent of the cones.
    fn smallest_slide(start: f64, end: &Pose, curvature: f64, bound: f64, towards: f64) -> Option<f64> {
        let fits = |slide: f64| {
            let moved = Pose { position: end.position + end.left() * slide, yaw: end.yaw };
            connect(start, &moved, curvature).is_ok_and(|s| s.max_abs_curvature() <= bound)
        };
        let first = (1..=4000).map(|i| towards * f64::from(i) * 0.005).find(|s| fits(*s))?;
        let (mut outside, mut inside) = (first - towards * 0.005, first);
        for _ in 0..30 {
            let middle = f64::midpoint(outside, inside);
            if fits(middle) { inside = middle } else { outside = middle }
        }
        Some(inside)
    }

    #[test]
    fn bound_holds_everywhere_and_the_slide_is_minimal() {
        let bound = 0.12;
        let mut compared = 0;
        for (start, end, curvature) in lattice_problems(400) {
            let free = connect(start, &end, curvature).unwrap();
            if free.max_abs_curvature() <= bound {
                continue;
            }
            let least = [1.0, -1.0].map(|side| smallest_slide(start, &end, curvature, bound, side));
            let Some(least) = least.into_iter().flatten().min_by(|a, b| a.abs().total_cmp(&b.abs())) else { continue };
            let bounded = match connect_bounded(start, &end, curvature, bound) {
                Ok(bounded) => bounded,
                Err(failure) => {
                    assert!(least.abs() > 5.0, "{failure}, but a slide of {least} is enough: {start} {end:?}");
                    continue;
                }
            };
            compared += 1;
            assert_eq!(bounded.method, Method::Convex);
            let spiral = bounded.spiral;
            for i in 0..=1000 {
                assert!(spiral.curvature(spiral.length * f64::from(i) / 1000.0).abs() <= bound);
            }
            let reached = spiral.end(&ORIGIN);
            assert!((reached.yaw - end.yaw).abs() < 1e-7);
            assert!((reached.position - end.position - end.left() * bounded.end_error).norm() < 1e-7);
            let excess = (bounded.end_error - least).abs();
            assert!(excess < 0.02, "slid {}, but {least} is enough: {start} {end:?}", bounded.end_error);
        }
        assert!(compared > 40, "too few comparisons: {compared}");
    }

    #[test]
    fn mirrored_problems_have_mirrored_slides() {
        let end = Pose::new(12.0, 4.0, 0.0);
        let left = connect_bounded(0.0, &end, 0.0, 0.1).unwrap();
        let right = connect_bounded(0.0, &Pose::new(12.0, -4.0, 0.0), 0.0, 0.1).unwrap();
        assert!(left.end_error < -0.1, "the end must slide towards the start heading: {left:?}");
        assert!((left.end_error + right.end_error).abs() < 1e-6);
        assert!((left.spiral.length - right.spiral.length).abs() < 1e-6);
    }

    #[test]
    fn reports_ends_that_the_bound_forbids() {
        let end = Pose::new(10.0, 0.0, 1.5);
        assert_eq!(connect_bounded(0.3, &end, 0.0, 0.2), Err(SpiralFailure::CurvatureBound));
        // a quarter turn within ten metres needs more curvature than 0.05
        assert!(connect_bounded(0.0, &end, 0.0, 0.05).is_err());
        assert_eq!(connect_bounded(f64::NAN, &end, 0.0, 0.2), Err(SpiralFailure::CurvatureBound));
        assert_eq!(connect_bounded(0.0, &Pose::new(f64::NAN, 0.0, 0.0), 0.0, 0.2), Err(SpiralFailure::NotFinite));
    }
}

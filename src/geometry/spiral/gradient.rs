//! Derivatives of the end of a spiral by its knots and its length.
//!
//! All of them follow from the moments ∫₀¹ uʳ (cos θ, sin θ) du. The heading θ = L Σ kᵢ ∫Nᵢ is linear in the knots with
//! polynomial factors. So the end is L times moment 0, its first derivatives are combinations of the moments up to K, and
//! its second derivatives of those up to 2K. One sweep of sines and cosines serves all three.

use super::{Polynomial, Spiral, Tables, panels};
use crate::geometry::Vector;
use crate::geometry::quadrature::GAUSS_8;

/// The end of a spiral in its start frame, with its derivatives by the knots and by the length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndGradient<const KNOTS: usize> {
    /// End position, m.
    pub end: Vector,
    /// Derivative of the end by each knot, m².
    pub by_knot: [Vector; KNOTS],
    /// Derivative of the end by the length with the knots fixed: the spiral is stretched, not continued.
    pub by_length: Vector,
    /// Heading at the end, rad.
    pub heading: f64,
    /// Derivative of the heading by each knot, m.
    pub heading_by_knot: [f64; KNOTS],
    /// Derivative of the heading by the length, 1/m.
    pub heading_by_length: f64,
}

impl<const K: usize> Spiral<K> {
    /// The end with its derivatives, to the accuracy of [`Spiral::point_at`].
    #[must_use]
    pub fn end_gradient(&self) -> EndGradient<K> {
        let jet = Jet::of(self);
        EndGradient {
            end: jet.end(),
            by_knot: std::array::from_fn(|i| jet.by_knot(i)),
            by_length: jet.by_length(),
            heading: jet.heading(),
            heading_by_knot: Tables::<K>::WEIGHTS.map(|w| w * self.length),
            heading_by_length: jet.heading() / self.length,
        }
    }

    /// Derivatives of the bending energy by the knots (dimensionless) and by the length (1/m²).
    #[must_use]
    pub fn bending_energy_gradient(&self) -> ([f64; K], f64) {
        let by_knot = Tables::<K>::MASS
            .map(|row| 2.0 * self.length * row.iter().zip(&self.knots).map(|(m, k)| m * k).sum::<f64>());
        (by_knot, self.bending_energy() / self.length)
    }
}

/// Number of moments: orders 0 to 2K for the quintic.
const MOMENTS: usize = 13;

/// A spiral with the moments of its direction (cos θ, sin θ).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Jet<const K: usize> {
    pub(crate) spiral: Spiral<K>,
    /// Coefficients of the curvature.
    curvature: Polynomial<K>,
    cos: [f64; MOMENTS],
    sin: [f64; MOMENTS],
}

impl<const K: usize> Jet<K> {
    pub(crate) fn of(spiral: &Spiral<K>) -> Self {
        let curvature = spiral.curvature_polynomial();
        let panels = panels::<K>(spiral.turning_bound());
        let width = 1.0 / panels as f64;
        let (mut cos, mut sin) = ([0.0; MOMENTS], [0.0; MOMENTS]);
        for panel in 0..panels {
            for (node, weight) in &GAUSS_8 {
                let u = width * (panel as f64 + node);
                let (s, c) = (spiral.length * curvature.integral(u)).sin_cos();
                let mut power = width * weight;
                for r in 0..=2 * K {
                    cos[r] += power * c;
                    sin[r] += power * s;
                    power *= u;
                }
            }
        }
        Self { spiral: *spiral, curvature, cos, sin }
    }

    /// ∫ uʳ times the direction.
    fn tangent(&self, r: usize) -> Vector {
        Vector::new(self.cos[r], self.sin[r])
    }

    /// ∫ uʳ times the normal to the left.
    fn normal(&self, r: usize) -> Vector {
        Vector::new(-self.sin[r], self.cos[r])
    }

    /// End position, m.
    pub(crate) fn end(&self) -> Vector {
        self.tangent(0) * self.spiral.length
    }

    /// Derivative of the end by a knot, m².
    pub(crate) fn by_knot(&self, i: usize) -> Vector {
        let mut sum = Vector::zeros();
        for (p, a) in Tables::<K>::INTEGRAL[i].iter().enumerate() {
            sum += self.normal(p + 1) * *a;
        }
        sum * (self.spiral.length * self.spiral.length)
    }

    /// Derivative of the end by the length.
    pub(crate) fn by_length(&self) -> Vector {
        let mut sum = Vector::zeros();
        for p in 0..K {
            sum += self.normal(p + 1) * self.integral_coefficient(p);
        }
        self.tangent(0) + sum * self.spiral.length
    }

    /// Heading at the end, rad.
    pub(crate) fn heading(&self) -> f64 {
        self.spiral.length * self.curvature.integral(1.0)
    }

    /// Coefficient of u^(p+1) in the integral of the curvature polynomial.
    fn integral_coefficient(&self, p: usize) -> f64 {
        self.curvature.0[p] / (p + 1) as f64
    }

    /// Second derivatives of λ·end: by two knots, by a knot and the length, by the length twice.
    pub(crate) fn second(&self, multiplier: Vector) -> ([[f64; K]; K], [f64; K], f64) {
        let length = self.spiral.length;
        let mut tangential = [0.0; MOMENTS];
        let mut normal = [0.0; MOMENTS];
        for r in 0..=2 * K {
            tangential[r] = multiplier.dot(&self.tangent(r));
            normal[r] = multiplier.dot(&self.normal(r));
        }
        let heading: [f64; K] = std::array::from_fn(|p| self.integral_coefficient(p));
        let integral = &Tables::<K>::INTEGRAL;
        // moments of Iᵢ u^(q+1), with Iᵢ the integral of basis polynomial i
        let mut crossed = [[0.0; K]; K];
        for (row, basis) in crossed.iter_mut().zip(integral) {
            for (q, value) in row.iter_mut().enumerate() {
                *value = basis.iter().enumerate().map(|(p, a)| a * tangential[p + q + 2]).sum();
            }
        }
        let dot = |a: &[f64; K], b: &[f64; K]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let shifted: [f64; K] = std::array::from_fn(|p| normal[p + 1]);
        let by_knots = std::array::from_fn(|i| {
            std::array::from_fn(|j| -length * length * length * dot(&crossed[i], &integral[j]))
        });
        let by_both = std::array::from_fn(|i| {
            2.0 * length * dot(&integral[i], &shifted) - length * length * dot(&crossed[i], &heading)
        });
        let turned: [f64; K] = std::array::from_fn(|q| (0..K).map(|p| heading[p] * tangential[p + q + 2]).sum::<f64>());
        let by_length = 2.0 * dot(&heading, &shifted) - length * dot(&turned, &heading);
        (by_knots, by_both, by_length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use proptest::prelude::*;

    const ORIGIN: Pose = Pose { position: crate::geometry::Point::new(0.0, 0.0), yaw: 0.0 };

    fn changed<const K: usize>(spiral: &Spiral<K>, variable: usize, by: f64) -> Spiral<K> {
        let mut spiral = *spiral;
        if variable == K {
            spiral.length += by
        } else {
            spiral.knots[variable] += by
        }
        spiral
    }

    fn check<const K: usize>(spiral: &Spiral<K>) {
        let gradient = spiral.end_gradient();
        let scale = spiral.length;
        assert!((gradient.end - spiral.end(&ORIGIN).position.coords).norm() < 1e-9);
        let (energy_by_knot, energy_by_length) = spiral.bending_energy_gradient();
        let multiplier = Vector::new(0.7, -0.4);
        let (by_knots, by_both, by_length) = Jet::of(spiral).second(multiplier);
        for variable in 0..=K {
            let h = if variable == K { 1e-5 * scale } else { 1e-5 / scale };
            let (plus, minus) = (changed(spiral, variable, h), changed(spiral, variable, -h));
            let difference = (plus.end(&ORIGIN).position - minus.end(&ORIGIN).position) / (2.0 * h);
            let (end, heading, energy) = if variable == K {
                (gradient.by_length, gradient.heading_by_length, energy_by_length)
            } else {
                (gradient.by_knot[variable], gradient.heading_by_knot[variable], energy_by_knot[variable])
            };
            // scales the tolerance to steps that move the end by the order of its length
            let unit = if variable == K { 1.0 } else { scale * scale };
            assert!((difference - end).norm() < 1e-7 * unit, "{variable}: {difference} {end}");
            let turned = (plus.heading_change(plus.length) - minus.heading_change(minus.length)) / (2.0 * h);
            assert!((turned - heading).abs() < 1e-7 * unit / scale, "{turned} {heading}");
            let slope = (plus.bending_energy() - minus.bending_energy()) / (2.0 * h);
            assert!((slope - energy).abs() < 1e-6 * unit / (scale * scale), "{slope} {energy}");
            let (after, before) = (plus.end_gradient(), minus.end_gradient());
            for other in 0..=K {
                let (difference, second) = if other == K {
                    let second = if variable == K { by_length } else { by_both[variable] };
                    ((after.by_length - before.by_length) / (2.0 * h), second)
                } else {
                    let second = if variable == K { by_both[other] } else { by_knots[variable][other] };
                    ((after.by_knot[other] - before.by_knot[other]) / (2.0 * h), second)
                };
                let unit = unit * if other == K { 1.0 } else { scale * scale } / scale;
                let difference = multiplier.dot(&difference);
                assert!((difference - second).abs() < 1e-6 * unit, "{variable} {other}: {difference} {second}");
            }
        }
    }

    proptest! {
        #[test]
        fn derivatives_agree_with_differences(
            turns in prop::array::uniform6(-2.0..2.0f64), length in 2.0..60.0f64
        ) {
            check(&Spiral::<6> { knots: turns.map(|t| t / length), length });
            check(&Spiral::<4> { knots: std::array::from_fn(|i| turns[i] / length), length });
        }
    }
}

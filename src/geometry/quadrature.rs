//! Fixed-order Gauss–Legendre quadrature (Abramowitz & Stegun, table 25.4).
//!
//! The n-point rule integrates polynomials of degree 2n−1 exactly. The integrands of this program are cos θ(s) and
//! sin θ(s). With a heading that turns by φ over an interval of length h, the error is about
//! h φ²ⁿ (n!)⁴ / ((2n+1) ((2n)!)³): h·5e-7·φ⁶ for three points, h·4e-13·φ¹⁰ for five, h·2e-23·φ¹⁶ for eight.
//!
//! Weak: there is no error estimate. The caller chooses the number of panels from a bound of φ.

/// Nodes on [0, 1] and weights of the three-point Gauss–Legendre rule: exact for polynomials up to degree five.
pub const GAUSS_3: [(f64, f64); 3] = [
    (0.112_701_665_379_258_31, 0.277_777_777_777_777_8),
    (0.5, 0.444_444_444_444_444_4),
    (0.887_298_334_620_741_7, 0.277_777_777_777_777_8),
];

/// Nodes on [0, 1] and weights of the five-point Gauss–Legendre rule: exact for polynomials up to degree nine.
pub const GAUSS_5: [(f64, f64); 5] = [
    (0.046_910_077_030_668, 0.118_463_442_528_094_5),
    (0.230_765_344_947_158_5, 0.239_314_335_249_683_2),
    (0.5, 0.284_444_444_444_444_4),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_2),
    (0.953_089_922_969_332, 0.118_463_442_528_094_5),
];

/// Nodes on [0, 1] and weights of the eight-point Gauss–Legendre rule: exact for polynomials up to degree fifteen.
pub const GAUSS_8: [(f64, f64); 8] = [
    (0.019_855_071_751_231_884, 0.050_614_268_145_188_13),
    (0.101_666_761_293_186_64, 0.111_190_517_226_687_24),
    (0.237_233_795_041_835_5, 0.156_853_322_938_943_63),
    (0.408_282_678_752_175_1, 0.181_341_891_689_181),
    (0.591_717_321_247_825, 0.181_341_891_689_181),
    (0.762_766_204_958_164_5, 0.156_853_322_938_943_63),
    (0.898_333_238_706_813_4, 0.111_190_517_226_687_24),
    (0.980_144_928_248_768_1, 0.050_614_268_145_188_13),
];

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫₀¹ xᵈ dx = 1/(d+1) holds up to the degree of the rule and fails one degree above it.
    fn check(rule: &[(f64, f64)]) {
        let integral = |degree: i32| rule.iter().map(|(x, w)| w * x.powi(degree)).sum::<f64>();
        let exact = 2 * i32::try_from(rule.len()).unwrap() - 1;
        for degree in 0..=exact {
            let error = integral(degree) - 1.0 / f64::from(degree + 1);
            assert!(error.abs() < 2e-15, "{} points, degree {degree}: off by {error:e}", rule.len());
        }
        assert!((integral(exact + 1) - 1.0 / f64::from(exact + 2)).abs() > 1e-11);
    }

    #[test]
    fn each_rule_is_exact_to_its_degree_and_no_further() {
        check(&GAUSS_3);
        check(&GAUSS_5);
        check(&GAUSS_8);
    }
}

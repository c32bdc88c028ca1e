//! Fixed-order Gauss–Legendre quadrature (Abramowitz & Stegun, table 25.4).

/// Nodes on [0, 1] and weights of the five-point Gauss–Legendre rule: exact for polynomials up to degree nine.
pub const GAUSS_5: [(f64, f64); 5] = [
    (0.046_910_077_030_668_0, 0.118_463_442_528_094_5),
    (0.230_765_344_947_158_5, 0.239_314_335_249_683_2),
    (0.5, 0.284_444_444_444_444_4),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_2),
    (0.953_089_922_969_332_0, 0.118_463_442_528_094_5),
];

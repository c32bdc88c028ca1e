//! Polynomials on the unit interval, given by their values at equal steps: the common core of cubic and quintic spirals.
//!
//! The tables are rational numbers, computed in integers at compile time and rounded once. Roots follow from the chain
//! of derivatives: between two neighbouring roots of its derivative a polynomial is monotone, so a sign change there
//! encloses exactly one root, which a bracketed Newton iteration finds. Quadratics are solved in closed form.
//!
//! Weak: a root without a sign change (a double root) may be missed. The roots are used to locate extrema, and a
//! derivative that touches zero without crossing it has no extremum there.

/// Lagrange basis on the knots u = i/(K−1): integer coefficients by knot and rising power, and one denominator per knot.
const fn integer_basis<const K: usize>() -> ([[i128; K]; K], [i128; K]) {
    let mut coefficients = [[0_i128; K]; K];
    let mut denominators = [1_i128; K];
    let steps = (K - 1) as i128;
    let mut i = 0;
    while i < K {
        // the product of (t − j) over the other knots j, in t = (K−1) u
        coefficients[i][0] = 1;
        let (mut j, mut degree) = (0, 0);
        while j < K {
            if j != i {
                let mut p = degree + 1;
                while p > 0 {
                    coefficients[i][p] = coefficients[i][p - 1] - j as i128 * coefficients[i][p];
                    p -= 1;
                }
                coefficients[i][0] *= -(j as i128);
                degree += 1;
                denominators[i] *= i as i128 - j as i128;
            }
            j += 1;
        }
        let (mut p, mut power) = (0, 1);
        while p < K {
            coefficients[i][p] *= power;
            power *= steps;
            p += 1;
        }
        i += 1;
    }
    (coefficients, denominators)
}

/// Least common multiple of 1…12: the denominators of the integrals of products of two quintics.
const COMMON: i128 = 27_720;

/// Tables of the Lagrange basis on K knots.
pub(crate) struct Tables<const K: usize>;

impl<const K: usize> Tables<K> {
    /// Coefficient of the basis polynomial of a knot (first index) by rising power (second).
    pub(crate) const BASIS: [[f64; K]; K] = {
        let (numerators, denominators) = integer_basis::<K>();
        let mut table = [[0.0; K]; K];
        let mut i = 0;
        while i < K {
            let mut p = 0;
            while p < K {
                table[i][p] = numerators[i][p] as f64 / denominators[i] as f64;
                p += 1;
            }
            i += 1;
        }
        table
    };

    /// Coefficients of the integral from zero, one power higher: ∫₀ᵘ Nᵢ = Σ `INTEGRAL[i][p]` u^(p+1).
    pub(crate) const INTEGRAL: [[f64; K]; K] = {
        let mut table = Self::BASIS;
        let mut i = 0;
        while i < K {
            let mut p = 0;
            while p < K {
                table[i][p] /= (p + 1) as f64;
                p += 1;
            }
            i += 1;
        }
        table
    };

    /// ∫₀¹ Nᵢ: the closed Newton–Cotes weights.
    pub(crate) const WEIGHTS: [f64; K] = {
        let (numerators, denominators) = integer_basis::<K>();
        let mut weights = [0.0; K];
        let mut i = 0;
        while i < K {
            let (mut sum, mut p) = (0, 0);
            while p < K {
                sum += numerators[i][p] * (COMMON / (p as i128 + 1));
                p += 1;
            }
            weights[i] = sum as f64 / (denominators[i] * COMMON) as f64;
            i += 1;
        }
        weights
    };

    /// Mᵢⱼ = ∫₀¹ Nᵢ Nⱼ: bending energy is L kᵀ M k.
    pub(crate) const MASS: [[f64; K]; K] = {
        let (numerators, denominators) = integer_basis::<K>();
        let mut mass = [[0.0; K]; K];
        let mut i = 0;
        while i < K {
            let mut j = 0;
            while j < K {
                let (mut sum, mut p) = (0, 0);
                while p < K {
                    let mut q = 0;
                    while q < K {
                        sum += numerators[i][p] * numerators[j][q] * (COMMON / (p as i128 + q as i128 + 1));
                        q += 1;
                    }
                    p += 1;
                }
                mass[i][j] = sum as f64 / (denominators[i] * denominators[j] * COMMON) as f64;
                j += 1;
            }
            i += 1;
        }
        mass
    };
}

/// A polynomial with K coefficients by rising powers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Polynomial<const K: usize>(pub(crate) [f64; K]);

impl<const K: usize> Polynomial<K> {
    /// The polynomial through K values at equal steps from u = 0 to 1.
    pub(crate) fn through(values: &[f64; K]) -> Self {
        let mut coefficients = [0.0; K];
        coefficients[0] = values[0]; // without rounding
        for (p, coefficient) in coefficients.iter_mut().enumerate().skip(1) {
            for (row, value) in Tables::<K>::BASIS.iter().zip(values) {
                *coefficient += row[p] * value;
            }
        }
        Self(coefficients)
    }

    #[inline]
    pub(crate) fn value(&self, u: f64) -> f64 {
        let mut sum = self.0[K - 1];
        for p in (0..K - 1).rev() {
            sum = self.0[p] + u * sum;
        }
        sum
    }

    #[inline]
    pub(crate) fn derivative(&self, u: f64) -> f64 {
        let mut sum = (K - 1) as f64 * self.0[K - 1];
        for p in (1..K - 1).rev() {
            sum = p as f64 * self.0[p] + u * sum;
        }
        sum
    }

    /// The derivative of the given order.
    pub(crate) fn derivative_of_order(&self, order: usize, u: f64) -> f64 {
        let mut coefficients = self.0;
        let mut count = K;
        for _ in 0..order {
            count = differentiate(&mut coefficients, count);
        }
        horner(&coefficients[..count], u)
    }

    /// The integral from 0 to u.
    #[inline]
    pub(crate) fn integral(&self, u: f64) -> f64 {
        let mut sum = self.0[K - 1] / K as f64;
        for p in (0..K - 1).rev() {
            sum = self.0[p] / (p + 1) as f64 + u * sum;
        }
        u * sum
    }

    /// Arguments in (0, 1) at which the derivative of the given order changes sign, ascending.
    pub(crate) fn roots_of_derivative(&self, order: usize) -> Roots {
        let mut coefficients = self.0;
        let mut count = K;
        for _ in 0..order {
            count = differentiate(&mut coefficients, count);
        }
        Roots::of(&coefficients[..count])
    }
}

/// Replaces `count` coefficients by those of the derivative; returns the remaining number of coefficients.
fn differentiate(coefficients: &mut [f64], count: usize) -> usize {
    for p in 1..count {
        coefficients[p - 1] = p as f64 * coefficients[p];
    }
    count.saturating_sub(1)
}

#[inline]
fn horner(coefficients: &[f64], u: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| c + u * sum)
}

/// Largest number of roots: those of the quartic derivative of a quintic.
const MAX_ROOTS: usize = 4;

/// Roots in (0, 1), ascending.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Roots {
    at: [f64; MAX_ROOTS],
    count: usize,
}

impl Roots {
    /// Roots of a polynomial of degree four at most.
    fn of(coefficients: &[f64]) -> Self {
        let mut roots = Self::default();
        match *coefficients {
            [] | [_] => {}
            [a, b] => roots.push(-a / b),
            [a, b, c] => {
                let [first, second] = quadratic_roots(c, b, a);
                roots.push(first.min(second));
                roots.push(first.max(second));
            }
            _ => {
                let mut derivative = [0.0; MAX_ROOTS + 1];
                derivative[..coefficients.len()].copy_from_slice(coefficients);
                let count = differentiate(&mut derivative, coefficients.len());
                let mut left = 0.0;
                for right in Self::of(&derivative[..count]).iter().chain([1.0]) {
                    if let Some(root) = bracketed(coefficients, &derivative[..count], left, right) {
                        roots.push(root);
                    }
                    left = right;
                }
            }
        }
        roots
    }

    fn push(&mut self, u: f64) {
        if u > 0.0 && u < 1.0 && self.count < MAX_ROOTS {
            self.at[self.count] = u;
            self.count += 1;
        }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = f64> + use<> {
        self.at.into_iter().take(self.count)
    }
}

/// The root between two arguments with values of opposite sign: Newton's method, with bisection where a step would leave
/// the bracket or is more than half the last one. `None` if the signs are equal.
fn bracketed(coefficients: &[f64], derivative: &[f64], mut low: f64, mut high: f64) -> Option<f64> {
    /// Bisection alone needs 53.
    const STEPS: usize = 64;
    let (at_low, at_high) = (horner(coefficients, low), horner(coefficients, high));
    if !(at_low < 0.0 && at_high > 0.0 || at_low > 0.0 && at_high < 0.0) {
        return None;
    }
    let rising = at_high > 0.0;
    let mut u = f64::midpoint(low, high);
    let mut last = high - low;
    for _ in 0..STEPS {
        let value = horner(coefficients, u);
        if value == 0.0 {
            break;
        }
        if (value > 0.0) == rising {
            high = u
        } else {
            low = u
        }
        let newton = u - value / horner(derivative, u);
        let inside = newton > low && newton < high && (newton - u).abs() < 0.5 * last;
        let next = if inside { newton } else { f64::midpoint(low, high) };
        last = (next - u).abs();
        u = next;
        // an error of this size in the argument of an extremum changes its value only to second order
        if last <= 1e-15 {
            break;
        }
    }
    Some(u)
}

/// Real roots of a u² + b u + c, without cancellation (Numerical Recipes, 5.6); NaN where there is none. With a negligible
/// leading coefficient one root goes to infinity, as it should.
fn quadratic_roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return [f64::NAN; 2];
    }
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    [q / a, c / q]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn cubic_tables_have_their_published_values() {
        let basis = Tables::<4>::BASIS;
        assert_eq!(basis[0], [1.0, -5.5, 9.0, -4.5]);
        assert_eq!(basis[1], [0.0, 9.0, -22.5, 13.5]);
        assert_eq!(basis[2], [0.0, -4.5, 18.0, -13.5]);
        assert_eq!(basis[3], [0.0, 1.0, -4.5, 4.5]);
        assert_eq!(Tables::<4>::WEIGHTS, [0.125, 0.375, 0.375, 0.125]);
        assert_eq!(Tables::<4>::MASS[0], [128.0 / 1680.0, 99.0 / 1680.0, -36.0 / 1680.0, 19.0 / 1680.0]);
        assert_eq!(Tables::<4>::MASS[1], [99.0 / 1680.0, 648.0 / 1680.0, -81.0 / 1680.0, -36.0 / 1680.0]);
        // the six-point closed Newton–Cotes rule
        assert_eq!(Tables::<6>::WEIGHTS, [19.0, 75.0, 50.0, 50.0, 75.0, 19.0].map(|w| w / 288.0));
    }

    /// Sign changes on a fine grid.
    fn sign_changes(polynomial: &Polynomial<6>, order: usize) -> Vec<f64> {
        let value = |u: f64| {
            let mut c = polynomial.0;
            let mut n = 6;
            for _ in 0..order {
                n = differentiate(&mut c, n);
            }
            horner(&c[..n], u)
        };
        let n = 5000;
        let grid: Vec<f64> = (0..=n).map(|i| f64::from(i) / f64::from(n)).collect();
        grid.windows(2).filter(|w| value(w[0]) * value(w[1]) < 0.0).map(|w| f64::midpoint(w[0], w[1])).collect()
    }

    proptest! {
        #[test]
        fn the_polynomial_goes_through_its_values(values in prop::array::uniform6(-1.0..1.0f64)) {
            let quintic = Polynomial::through(&values);
            for (i, value) in values.iter().enumerate() {
                prop_assert!((quintic.value(i as f64 / 5.0) - value).abs() < 1e-12);
            }
            let mean: f64 = Tables::<6>::WEIGHTS.iter().zip(&values).map(|(w, v)| w * v).sum();
            prop_assert!((quintic.integral(1.0) - mean).abs() < 1e-12); // monomials up to 500 cancel
        }

        #[test]
        fn every_sign_change_of_a_derivative_is_a_root(values in prop::array::uniform6(-1.0..1.0f64), order in 1..4usize) {
            let quintic = Polynomial::through(&values);
            let roots: Vec<f64> = quintic.roots_of_derivative(order).iter().collect();
            for expected in sign_changes(&quintic, order) {
                prop_assert!(roots.iter().any(|r| (r - expected).abs() < 2e-4), "{expected} is not among {roots:?}");
            }
            prop_assert!(roots.windows(2).all(|w| w[0] <= w[1]));
        }
    }
}

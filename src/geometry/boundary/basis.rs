//! The rows of the fixed conditions, with an orthonormal basis of their row space and their null space.

/// Maximum number of fixed rows: four end conditions, two rates.
pub(super) const MAX_ROWS: usize = 6;

/// Linearised conditions: `rows · Δx = −residual`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<const K: usize> {
    pub(super) rows: [[f64; K]; MAX_ROWS],
    pub(super) residual: [f64; MAX_ROWS],
    pub(super) count: usize,
}

impl<const K: usize> Rows<K> {
    pub(super) fn none() -> Self {
        Self { rows: [[0.0; K]; MAX_ROWS], residual: [0.0; MAX_ROWS], count: 0 }
    }

    pub(super) fn push(&mut self, row: [f64; K], residual: f64) {
        if self.count < MAX_ROWS {
            self.rows[self.count] = row;
            self.residual[self.count] = residual;
            self.count += 1;
        }
    }

    /// Largest |residual|.
    pub(super) fn worst(&self) -> f64 {
        self.residual[..self.count].iter().fold(0.0, |m: f64, r| if r.is_nan() { f64::NAN } else { m.max(r.abs()) })
    }
}

/// Orthonormal directions: the first `fixed` span the rows, the others span their null space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Basis<const K: usize> {
    directions: [[f64; K]; K],
    /// rows = triangle · directions, lower triangular.
    triangle: [[f64; MAX_ROWS]; MAX_ROWS],
    fixed: usize,
}

impl<const K: usize> Basis<K> {
    /// Gram–Schmidt with a second pass for accuracy. `None` if the rows are linearly dependent or not finite.
    pub(super) fn of(rows: &Rows<K>) -> Option<Self> {
        /// A row is dependent if less than this fraction of its norm remains.
        const DEPENDENT: f64 = 1e-9;
        let mut basis = Self { directions: [[0.0; K]; K], triangle: [[0.0; MAX_ROWS]; MAX_ROWS], fixed: rows.count };
        if rows.count > K {
            return None;
        }
        for (i, row) in rows.rows[..rows.count].iter().enumerate() {
            let mut own = *row;
            for _ in 0..2 {
                for j in 0..i {
                    let share = dot(&own, &basis.directions[j]);
                    basis.triangle[i][j] += share;
                    add(&mut own, -share, &basis.directions[j]);
                }
            }
            let norm = dot(&own, &own).sqrt();
            // NaN fails as well
            if !(norm > DEPENDENT * dot(row, row).sqrt() && norm.is_finite()) {
                return None;
            }
            basis.triangle[i][i] = norm;
            basis.directions[i] = own.map(|v| v / norm);
        }
        basis.complete();
        Some(basis)
    }

    /// Completes the basis with the unit vectors that the directions span least.
    fn complete(&mut self) {
        for i in self.fixed..K {
            let remaining = |axis: usize| 1.0 - self.directions[..i].iter().map(|d| d[axis] * d[axis]).sum::<f64>();
            let mut axis = 0;
            for candidate in 1..K {
                if remaining(candidate) > remaining(axis) {
                    axis = candidate;
                }
            }
            let mut own = [0.0; K];
            own[axis] = 1.0;
            for _ in 0..2 {
                for j in 0..i {
                    let share = dot(&own, &self.directions[j]);
                    add(&mut own, -share, &self.directions[j]);
                }
            }
            let norm = dot(&own, &own).sqrt();
            self.directions[i] = own.map(|v| v / norm);
        }
    }

    /// The directions in the null space of the conditions.
    pub(super) fn free(&self) -> &[[f64; K]] {
        &self.directions[self.fixed..]
    }

    /// The least-norm step with rows · step = −residual.
    pub(super) fn correction(&self, residual: &[f64; MAX_ROWS]) -> [f64; K] {
        let mut shares = [0.0; MAX_ROWS];
        let mut step = [0.0; K];
        for i in 0..self.fixed {
            let known: f64 = (0..i).map(|j| self.triangle[i][j] * shares[j]).sum();
            shares[i] = (-residual[i] - known) / self.triangle[i][i];
            add(&mut step, shares[i], &self.directions[i]);
        }
        step
    }

    /// Multipliers λ with rowsᵀ λ = gradient, in the sense of least squares.
    pub(super) fn multipliers(&self, gradient: &[f64; K]) -> [f64; MAX_ROWS] {
        let mut multipliers = [0.0; MAX_ROWS];
        for i in (0..self.fixed).rev() {
            let known: f64 = (i + 1..self.fixed).map(|j| self.triangle[j][i] * multipliers[j]).sum();
            multipliers[i] = (dot(gradient, &self.directions[i]) - known) / self.triangle[i][i];
        }
        multipliers
    }
}

pub(super) fn dot<const K: usize>(a: &[f64; K], b: &[f64; K]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `a += factor · b`.
pub(super) fn add<const K: usize>(a: &mut [f64; K], factor: f64, b: &[f64; K]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += factor * b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn corrections_satisfy_the_rows_and_free_directions_leave_them_unchanged(
            entries in prop::array::uniform6(prop::array::uniform6(-2.0..2.0f64)), count in 1..6usize,
        ) {
            let mut rows = Rows::<6>::none();
            for row in &entries[..count] {
                rows.push(*row, row[0] - 0.3);
            }
            let Some(basis) = Basis::of(&rows) else { return Err(TestCaseError::reject("dependent")) };
            let step = basis.correction(&rows.residual);
            prop_assume!(dot(&step, &step) < 1e6);
            for i in 0..count {
                prop_assert!((dot(&rows.rows[i], &step) + rows.residual[i]).abs() < 1e-9);
                for free in basis.free() {
                    prop_assert!(dot(&rows.rows[i], free).abs() < 1e-12);
                    prop_assert!(dot(&step, free).abs() < 1e-9);
                }
            }
            // a known combination of the rows gives back its factors
            let mut gradient = [0.0; 6];
            for i in 0..count {
                add(&mut gradient, 1.0 + i as f64, &rows.rows[i]);
            }
            let multipliers = basis.multipliers(&gradient);
            let mut again = [0.0; 6];
            for (multiplier, row) in multipliers.iter().zip(&rows.rows[..count]) {
                add(&mut again, *multiplier, row);
            }
            add(&mut again, -1.0, &gradient);
            prop_assert!(dot(&again, &again).sqrt() < 1e-9);
        }
    }

    #[test]
    fn rejects_dependent_rows_and_rows_that_are_not_finite() {
        let mut rows = Rows::<4>::none();
        rows.push([1.0, 2.0, 0.0, 0.0], 0.0);
        rows.push([2.0, 4.0, 0.0, 0.0], 0.0);
        assert!(Basis::of(&rows).is_none());
        let mut rows = Rows::<4>::none();
        rows.push([f64::NAN; 4], 0.0);
        assert!(Basis::of(&rows).is_none());
    }
}

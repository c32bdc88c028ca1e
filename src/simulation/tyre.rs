//! One tyre: contact patch force from slip, with combined slip, saturation and relaxation.
//!
//! The tread is a brush (Pacejka, *Tire and Vehicle Dynamics*, 3rd ed. 2012, section 3.2): with normalised combined
//! slip ρ = |(c_x κ, c_y tan α)| / μ, the force is μ F_z g(ρ) in the direction (c_x κ, c_y tan α), where g(ρ) = ρ −
//! ρ²/3 + ρ³/27 up to full sliding at ρ = 3, and 1 beyond. Therefore the slope at zero slip is the slip stiffness, the
//! force stays inside the friction circle, and there is no peak: a locked wheel transmits as much force as a rolling
//! one at its optimum.
//!
//! Slip is not computed by division by the speed but integrated as the deflection u of the carcass in metres (single
//! contact point transient model, ibid. section 7.2): u̇ = −V_s − |V_x| u/σ and slip = u/σ. At speed this is a
//! first-order lag over the relaxation length σ; at standstill it is a spring, which holds a parked car. Damping of the
//! carcass is included (slip = (u + τ u̇)/σ): without it a stopped car would oscillate on its tyres for seconds. τ
//! decreases with speed so that at least half of the relaxation lag remains.
//!
//! Limitations: one relaxation length for both directions; stiffness proportional to load; no aligning moment; no
//! camber; friction independent of speed.

use crate::vehicle::Tyres;

/// Normalised slip at which the whole patch slides.
const SLIDING: f64 = 3.0;
/// Time constant of the carcass damping, s: a car that stands on its tyres' springs (4 Hz) has a damping ratio of 0.4,
/// and the wheels' spin (about 120 rad/s) is still far from the stability limit of explicit steps of 1 ms.
const CARCASS_DAMPING: f64 = 0.03;

/// The state of a tyre: deflections of the carcass in the wheel's frame, m.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tyre {
    deflection: [f64; 2],
}

/// Inputs of the tyre model during a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patch {
    /// Speed of the hub along the wheel's heading, m/s.
    pub(super) rolling: f64,
    /// Sliding velocity of the patch over the ground: along the wheel's heading, and to its left, m/s.
    pub(super) sliding: [f64; 2],
    /// Vertical load, N.
    pub(super) load: f64,
    /// Friction coefficient.
    pub(super) friction: f64,
    /// Slip stiffness per unit of load: longitudinal, lateral.
    pub(super) stiffness: [f64; 2],
}

impl Tyre {
    /// Integrates the deflection over `dt` seconds and returns the force on the vehicle in the wheel's frame:
    /// forward, left, N.
    pub(super) fn step(&mut self, tyres: &Tyres, patch: &Patch, dt: f64) -> [f64; 2] {
        let sigma = tyres.relaxation_length;
        let decay = patch.rolling.abs() / sigma;
        let before = self.deflection;
        // implicit in the deflection: stable at any speed
        let mut after = [0, 1].map(|i| (before[i] - dt * patch.sliding[i]) / (1.0 + dt * decay));
        let rho = normalised(patch, after, sigma);
        if rho > SLIDING {
            after = after.map(|u| u * SLIDING / rho);
        }
        self.deflection = after;
        let tau = CARCASS_DAMPING.min(0.5 / decay.max(f64::MIN_POSITIVE));
        let damped = [0, 1].map(|i| after[i] + tau * (after[i] - before[i]) / dt);
        let rho = normalised(patch, damped, sigma);
        if rho <= 0.0 {
            return [0.0, 0.0];
        }
        let force = patch.friction * patch.load * brush(rho);
        [0, 1].map(|i| force * patch.stiffness[i] * damped[i] / (sigma * patch.friction * rho))
    }
}

/// Normalised combined slip ρ.
fn normalised(patch: &Patch, deflection: [f64; 2], sigma: f64) -> f64 {
    (patch.stiffness[0] * deflection[0]).hypot(patch.stiffness[1] * deflection[1]) / (sigma * patch.friction)
}

/// Force of the brush model over its maximum, for a normalised slip.
fn brush(rho: f64) -> f64 {
    let r = rho.min(SLIDING);
    r * (1.0 - r / 3.0 + r * r / 27.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle;
    use proptest::prelude::*;

    fn tyres() -> Tyres {
        static TYRES: std::sync::LazyLock<Tyres> =
            std::sync::LazyLock::new(|| vehicle::load("bmw_320i").unwrap().tyres);
        *TYRES
    }

    fn patch(rolling: f64, sliding: [f64; 2]) -> Patch {
        let t = tyres();
        Patch { rolling, sliding, load: 3000.0, friction: 1.0, stiffness: [t.longitudinal, t.cornering_front] }
    }

    /// The steady-state force.
    fn steady(p: &Patch) -> [f64; 2] {
        let mut tyre = Tyre::default();
        (0..20_000).map(|_| tyre.step(&tyres(), p, 0.001)).last().unwrap()
    }

    #[test]
    fn small_slip_force_is_linear_and_opposes_sliding() {
        let slip = 1e-4;
        let [x, y] = steady(&patch(10.0, [10.0 * slip, 0.0]));
        assert!((x / (-tyres().longitudinal * slip * 3000.0) - 1.0).abs() < 1e-3 && y == 0.0, "{x} {y}");
        let [x, y] = steady(&patch(10.0, [0.0, 10.0 * slip]));
        assert!((y / (-tyres().cornering_front * slip * 3000.0) - 1.0).abs() < 1e-3 && x == 0.0, "{x} {y}");
    }

    #[test]
    fn a_locked_wheel_slides_with_the_full_friction() {
        let [x, y] = steady(&patch(10.0, [10.0, 0.0]));
        assert!((x + 3000.0).abs() < 1e-9 && y == 0.0, "{x}");
    }

    #[test]
    fn lag_is_the_relaxation_length_at_low_speed() {
        let (v, t) = (2.0, tyres());
        let p = patch(v, [0.0, v * 1e-4]);
        let end = steady(&p)[1];
        let mut tyre = Tyre::default();
        let steps = (0..).take_while(|_| tyre.step(&t, &p, 1e-4)[1] / end < 1.0 - (-1.0f64).exp()).count();
        let distance = v * steps as f64 * 1e-4;
        // the damping of the carcass reduces the lag by its time constant
        let expected = t.relaxation_length - v * CARCASS_DAMPING;
        assert!((distance / expected - 1.0).abs() < 0.1, "{distance} m, expected about {expected} m");
    }

    proptest! {
        #[test]
        fn the_force_stays_inside_the_friction_circle(
            v in -40.0..40.0, sx in -40.0..40.0, sy in -40.0..40.0, load in 0.0..8000.0, mu in 0.05..1.5, steps in 1usize..200,
        ) {
            let p = Patch { load, friction: mu, ..patch(v, [sx, sy]) };
            let mut tyre = Tyre::default();
            for _ in 0..steps {
                let [x, y] = tyre.step(&tyres(), &p, 0.001);
                prop_assert!(x.hypot(y) <= mu * load * (1.0 + 1e-12), "{x} {y}");
            }
        }

        #[test]
        fn mirrored_sliding_gives_the_mirrored_force(v in -40.0..40.0, sx in -5.0..5.0, sy in -5.0..5.0) {
            let (mut a, mut b) = (Tyre::default(), Tyre::default());
            for _ in 0..50 {
                let [x, y] = a.step(&tyres(), &patch(v, [sx, sy]), 0.001);
                let [mx, my] = b.step(&tyres(), &patch(v, [sx, -sy]), 0.001);
                prop_assert_eq!((x, y), (mx, -my));
            }
        }
    }
}

//! CommonRoad solutions: the driven run as a trajectory of the kinematic single-track model (KS).
//!
//! A solution is checked by re-simulation: each state must follow from the one before by the model under one constant
//! steering rate and acceleration inside the vehicle's limits, to within 2 cm. A car on tyres slips, so its states are
//! not quite those of the model. [`fit`] therefore looks for the inputs under which the model, starting exactly at the
//! planning problem's initial state, stays as close as it can to what was driven, and says how far away it came at worst.
//!
//! **Problem.** State z = (x, y, δ, v, ψ) of the rear axle (Althoff, Würsching, *CommonRoad: Vehicle Models*, 2020,
//! section 4: ẋ = v cos ψ, ẏ = v sin ψ, δ̇ = u₁, v̇ = u₂, ψ̇ = v tan δ / wheelbase), inputs u constant over each time step.
//!
//! > minimise Σₖ |c(zₖ) − rₖ|²/σₚ² + (ψₖ − ψʳₖ)²/σ_ψ² + (vₖ − vʳₖ)²/σᵥ² + u₁²/σ₁² + u₂²/σ₂²
//! > subject to zₖ₊₁ = f(zₖ, uₖ), |δ|, |δ̇|, u₂ and the friction circle inside the vehicle's limits, v ≥ 0,
//!
//! where c is the vehicle's centre and r, ψʳ, vʳ what was driven.
//!
//! **Technique.** Iterated linear-quadratic regulation (Li, Todorov, ICINCO 2004) with limited inputs (Tassa, Mansard,
//! Todorov, ICRA 2014): a Riccati recursion backwards over the linearised model, in which an input at its limit has no
//! feedback, a roll-out of the true model forwards with the inputs clamped to their limits, a line search on
//! the true cost. Every roll-out is feasible by construction, so the result is, wherever the iteration ends.
//!
//! **Weak**: forward motion only; where the drive's limits bind for long, clamping makes it slower than optimal; the
//! log's gaps are interpolated.

mod model;

use std::f64::consts::TAU;
use std::fmt::Write as _;

use nalgebra::{Matrix2, Matrix2x5, Matrix5, Vector2, Vector5};

use crate::geometry::{Point, Pose, wrap_angle};
use crate::map::{PlanningProblem, Scenario};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;
use model::{Model, PSI, V};

/// A run as states of the kinematic single-track model.
#[derive(Debug, Clone, PartialEq)]
pub struct KinematicFit {
    /// One state for each time step of the file, from the problem's initial one.
    pub states: Vec<KinematicState>,
    /// Largest distance between the centres of model and driven vehicle at a time step, m.
    pub max_deviation_m: f64,
}

/// A state of the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KinematicState {
    /// Time step of the file.
    pub time_step: i64,
    /// Pose of the vehicle's **centre**.
    pub centre: Pose,
    /// Speed of the rear axle, m/s.
    pub speed: f64,
    /// Steering angle, rad.
    pub steering: f64,
}

/// Deviations that cost as much as each other: these decide what the fit gives up for what.
mod sigma {
    /// Of the centre, m.
    pub(super) const POSITION: f64 = 0.01;
    /// Of the heading, rad: slip angles are of this size.
    pub(super) const HEADING: f64 = 0.05;
    /// Of the speed, m/s.
    pub(super) const SPEED: f64 = 0.5;
    /// Steering rate, rad/s: large, a mere regularisation.
    pub(super) const STEERING_RATE: f64 = 2.0;
    /// Acceleration, m/s².
    pub(super) const ACCELERATION: f64 = 20.0;
}

/// Most iterations; runs of 20 s take about ten.
const MAX_ITERATIONS: usize = 60;

/// Extra weight on the inputs, in multiples of their own, when no step along the gains is cheaper: from, and at most.
const DAMPING: std::ops::Range<f64> = 1.0..1e9;

/// A relative gain in cost below this ends the iteration.
const ENOUGH: f64 = 1e-7;

/// Fits the model to a driven log.
///
/// The first state is exactly the problem's initial one (its steering angle, which files do not give, is the log's), the
/// last one is at `last_time_step`; where the log ends earlier (or is no longer finite), its last sample goes on. An empty log gives the initial
/// state alone.
#[must_use]
pub fn fit(
    scenario: &Scenario,
    problem: &PlanningProblem,
    vehicle: &Vehicle,
    log: &Log,
    last_time_step: i64,
) -> KinematicFit {
    let first = problem.initial.time_step;
    let origin = problem.initial.centre.position;
    let samples = &log.samples[..log.samples.iter().position(|s| !is_finite(s)).unwrap_or(log.samples.len())];
    let steps = if samples.is_empty() { 0 } else { usize::try_from(last_time_step - first).unwrap_or(0) };
    #[allow(clippy::cast_precision_loss)] // time steps are at most 1e9
    let wanted: Vec<Wanted> = (0..=steps)
        .map(|k| Wanted::at(samples, vehicle, (first + k as i64) as f64 * scenario.time_step, origin))
        .collect();
    let model = Model::new(vehicle, scenario.time_step);
    let steering = samples.first().map_or(0.0, |s| s.steering);
    let start = model.start(&problem.initial, steering);
    let states = Fitter { model: &model, wanted: &wanted }.solve(start, steps);
    let deviation = |(z, w): (&Vector5<f64>, &Wanted)| (model.centre(z) - w.centre).norm();
    #[allow(clippy::cast_possible_wrap)] // a count of states in memory
    let state = |(k, z): (usize, &Vector5<f64>)| KinematicState {
        time_step: first + k as i64,
        centre: Pose { position: origin + model.centre(z).coords, yaw: z[PSI] },
        speed: z[V],
        steering: z[model::DELTA],
    };
    let max_deviation_m =
        if samples.is_empty() { 0.0 } else { states.iter().zip(&wanted).map(deviation).fold(0.0, f64::max) };
    KinematicFit { states: states.iter().enumerate().map(state).collect(), max_deviation_m }
}

/// Whether what the fit reads of a sample is finite; a log may end in a broken one.
fn is_finite(s: &Sample) -> bool {
    [s.time, s.pose.position.x, s.pose.position.y, s.pose.yaw, s.speed, s.steering].iter().all(|v| v.is_finite())
}

/// What was driven at a time step, relative to the initial position.
struct Wanted {
    centre: Point,
    yaw: f64,
    speed: f64,
}

impl Wanted {
    fn at(samples: &[Sample], vehicle: &Vehicle, time: f64, origin: Point) -> Self {
        let after = samples.partition_point(|s| s.time <= time);
        let (pose, speed) = match (after.checked_sub(1).and_then(|i| samples.get(i)), samples.get(after)) {
            (Some(a), Some(b)) => {
                let ratio = (time - a.time) / (b.time - a.time);
                (a.pose.interpolated(&b.pose, ratio), a.speed + (b.speed - a.speed) * ratio)
            }
            (Some(s), None) | (None, Some(s)) => (s.pose, s.speed),
            (None, None) => (Pose { position: origin, yaw: 0.0 }, 0.0),
        };
        let centre = vehicle.centre_of_rear_axle(&pose);
        Self { centre: Point::from(centre.position - origin), yaw: centre.yaw, speed }
    }
}

/// One linear-quadratic step: u = ū + α k + K (z − z̄).
struct Gain {
    constant: Vector2<f64>,
    feedback: Matrix2x5<f64>,
}

/// States, inputs and cost.
type RollOut = (Vec<Vector5<f64>>, Vec<Vector2<f64>>, f64);

struct Fitter<'a> {
    model: &'a Model,
    wanted: &'a [Wanted],
}

impl Fitter<'_> {
    fn solve(&self, start: Vector5<f64>, steps: usize) -> Vec<Vector5<f64>> {
        let mut inputs = vec![Vector2::zeros(); steps];
        let mut states = self.first_guess(start, &mut inputs);
        let mut cost = self.cost(&states, &inputs);
        let mut damping = 0.0;
        for _ in 0..MAX_ITERATIONS {
            let gains = self.backward(&states, &inputs, damping);
            let Some((new_states, new_inputs, new_cost)) = self.search(&states, &inputs, &gains, cost) else {
                damping = (damping * 10.0_f64).max(DAMPING.start);
                if damping > DAMPING.end {
                    break;
                }
                continue;
            };
            let gain = cost - new_cost;
            (states, inputs, cost) = (new_states, new_inputs, new_cost);
            if gain <= ENOUGH * cost {
                break;
            }
            damping = if damping > DAMPING.start { damping * 0.1 } else { 0.0 };
        }
        states
    }

    /// A roll-out that follows the driven speed and turns towards the driven heading: near enough to linearise about.
    fn first_guess(&self, start: Vector5<f64>, inputs: &mut [Vector2<f64>]) -> Vec<Vector5<f64>> {
        let mut states = vec![start];
        for (input, next) in inputs.iter_mut().zip(&self.wanted[1..]) {
            let z = states[states.len() - 1];
            *input = self.model.clamp(&z, self.model.towards(&z, next.yaw, next.speed));
            states.push(self.model.step(&z, input));
        }
        states
    }

    /// Weighted deviations of a state: centre (2), heading, speed.
    fn residual(&self, z: &Vector5<f64>, wanted: &Wanted) -> nalgebra::Vector4<f64> {
        let position = (self.model.centre(z) - wanted.centre) / sigma::POSITION;
        let heading = wrap_angle(z[PSI] - wanted.yaw) / sigma::HEADING;
        nalgebra::Vector4::new(position.x, position.y, heading, (z[V] - wanted.speed) / sigma::SPEED)
    }

    fn cost(&self, states: &[Vector5<f64>], inputs: &[Vector2<f64>]) -> f64 {
        let deviations: f64 = states.iter().zip(self.wanted).map(|(z, w)| self.residual(z, w).norm_squared()).sum();
        deviations + inputs.iter().map(|u| input_weights().component_mul(u).dot(u)).sum::<f64>()
    }

    /// The Riccati recursion, from the last state to the first.
    fn backward(&self, states: &[Vector5<f64>], inputs: &[Vector2<f64>], damping: f64) -> Vec<Gain> {
        let (mut gradient, mut hessian) = self.quadratic(states.len() - 1, states);
        let mut gains: Vec<Gain> = Vec::with_capacity(inputs.len());
        for k in (0..inputs.len()).rev() {
            let (a, b) = self.model.linearised(&states[k], &inputs[k]);
            let r = input_weights();
            let q_u = b.transpose() * gradient + r.component_mul(&inputs[k]);
            let q_uu: Matrix2<f64> = b.transpose() * hessian * b + Matrix2::from_diagonal(&(r * (1.0 + damping)));
            let q_ux = b.transpose() * hessian * a;
            let (low, high) = self.model.bounds(&states[k], &inputs[k]);
            let gain = limited_gain(&q_uu, &q_u, &q_ux, &(low - inputs[k]), &(high - inputs[k]));
            let (l_x, l_xx) = self.quadratic(k, states);
            let feedback = gain.feedback.transpose();
            let q_x = l_x + a.transpose() * gradient;
            gradient = q_x + feedback * (q_uu * gain.constant + q_u) + q_ux.transpose() * gain.constant;
            let cross = feedback * q_ux;
            let full = l_xx + a.transpose() * hessian * a + feedback * q_uu * gain.feedback + cross + cross.transpose();
            hessian = (full + full.transpose()) * 0.5;
            gains.push(gain);
        }
        gains.reverse();
        gains
    }

    /// Half the gradient and half the Gauss–Newton Hessian of the cost of state `k`.
    fn quadratic(&self, k: usize, states: &[Vector5<f64>]) -> (Vector5<f64>, Matrix5<f64>) {
        let jacobian = self.model.residual_jacobian(&states[k]);
        let residual = self.residual(&states[k], &self.wanted[k]);
        (jacobian.transpose() * residual, jacobian.transpose() * jacobian)
    }

    /// The first roll-out along the gains, with ever smaller steps, that is cheaper.
    fn search(&self, states: &[Vector5<f64>], inputs: &[Vector2<f64>], gains: &[Gain], cost: f64) -> Option<RollOut> {
        /// Halvings of the step; after that, damping does better.
        const HALVINGS: i32 = 5;
        (0..HALVINGS).find_map(|halvings| {
            let ratio = 0.5_f64.powi(halvings);
            let mut rolled = vec![states[0]];
            let mut chosen = Vec::with_capacity(inputs.len());
            for (k, gain) in gains.iter().enumerate() {
                let z = rolled[k];
                let wanted = inputs[k] + gain.constant * ratio + gain.feedback * (z - states[k]);
                let u = self.model.clamp(&z, wanted);
                rolled.push(self.model.step(&z, &u));
                chosen.push(u);
            }
            let new_cost = self.cost(&rolled, &chosen);
            (new_cost < cost).then_some((rolled, chosen, new_cost))
        })
    }
}

/// The change of input that minimises ½ uᵀ Q_uu u + uᵀ Q_u inside a box, and the feedback of what is not at a limit: the
/// best of the unlimited minimum and of those on the box's edges.
fn limited_gain(
    q_uu: &Matrix2<f64>,
    q_u: &Vector2<f64>,
    q_ux: &Matrix2x5<f64>,
    low: &Vector2<f64>,
    high: &Vector2<f64>,
) -> Gain {
    // Positive definite: the weights of the inputs are positive.
    let inverse = q_uu.try_inverse().unwrap_or_else(Matrix2::zeros);
    let free = -inverse * q_u;
    if (0..2).all(|i| low[i] <= free[i] && free[i] <= high[i]) {
        return Gain { constant: free, feedback: -inverse * q_ux };
    }
    let value = |u: &Vector2<f64>| 0.5 * u.dot(&(q_uu * u)) + u.dot(q_u);
    let mut best = (f64::INFINITY, Gain { constant: Vector2::zeros(), feedback: Matrix2x5::zeros() });
    for (fixed, at) in [(0, low[0]), (0, high[0]), (1, low[1]), (1, high[1])] {
        let other = 1 - fixed;
        let unlimited = -(q_u[other] + q_uu[(other, fixed)] * at) / q_uu[(other, other)];
        let mut constant = Vector2::zeros();
        constant[fixed] = at;
        constant[other] = unlimited.clamp(low[other], high[other]);
        let mut feedback = Matrix2x5::zeros();
        if constant[other] == unlimited {
            feedback.set_row(other, &(-q_ux.row(other) / q_uu[(other, other)]));
        }
        if value(&constant) < best.0 {
            best = (value(&constant), Gain { constant, feedback });
        }
    }
    best.1
}

fn input_weights() -> Vector2<f64> {
    Vector2::new(sigma::STEERING_RATE.powi(-2), sigma::ACCELERATION.powi(-2))
}

/// The solution file, for a vehicle with a CommonRoad type (`None` otherwise): model KS, cost function SM1.
#[must_use]
pub fn to_xml(scenario: &Scenario, problem: &PlanningProblem, vehicle: &Vehicle, fit: &KinematicFit) -> Option<String> {
    let kind = vehicle.commonroad_type?;
    let id = format!("KS{kind}:SM1:{}:{}", scenario.id, scenario.version);
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Writing to a String cannot fail.
    let _ = writeln!(xml, "<CommonRoadSolution benchmark_id=\"{}\">", escaped(&id));
    // Headings stay continuous and start with the problem's own, less whole turns that the format does not allow.
    let turns = fit.states.first().map_or(0.0, |s| (s.centre.yaw / TAU).trunc() * TAU);
    let _ = writeln!(xml, "  <ksTrajectory planningProblem=\"{}\">", problem.id);
    for s in &fit.states {
        let Pose { position, yaw } = s.centre;
        let _ = writeln!(
            xml,
            "    <ksState>\n      <x>{}</x>\n      <y>{}</y>\n      <steeringAngle>{}</steeringAngle>\n      \
             <velocity>{}</velocity>\n      <orientation>{}</orientation>\n      <time>{}</time>\n    </ksState>",
            position.x,
            position.y,
            s.steering,
            s.speed,
            yaw - turns,
            s.time_step
        );
    }
    xml.push_str("  </ksTrajectory>\n</CommonRoadSolution>\n");
    Some(xml)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests;

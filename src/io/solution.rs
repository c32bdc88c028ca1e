//! Writer of CommonRoad solutions: the run as a trajectory of the kinematic single-track model (KS).
//!
//! The checker of solutions simulates them again: each state must follow from the previous one by the model, under one
//! constant steering rate and acceleration inside the vehicle's limits, to within 2 cm. The simulated vehicle has tyre slip,
//! so its states differ from those of the model. [`fit`] finds inputs under which the model starts exactly at the initial
//! state of the planning problem and stays close to the log; it returns the largest deviation.
//!
//! **Problem.** State z = (x, y, δ, v, ψ) of the rear axle (Althoff, Würsching, *CommonRoad: Vehicle Models*, 2020,
//! section 4: ẋ = v cos ψ, ẏ = v sin ψ, δ̇ = u₁, v̇ = u₂, ψ̇ = v tan δ / wheelbase), inputs u constant over each time step.
//!
//! > minimise Σₖ |c(zₖ) − rₖ|²/σₚ² + (ψₖ − ψʳₖ)²/σ_ψ² + (vₖ − vʳₖ)²/σᵥ² + u₁²/σ₁² + u₂²/σ₂²
//! > subject to zₖ₊₁ = f(zₖ, uₖ), |δ|, |δ̇|, u₂ and the friction circle inside the vehicle's limits, v ≥ 0,
//!
//! where c is the vehicle's centre, and r, ψʳ, vʳ are the centre, heading and speed of the log (the reference).
//!
//! **Technique.** Iterative linear-quadratic regulator (Li, Todorov, ICINCO 2004) with input limits (Tassa, Mansard,
//! Todorov, ICRA 2014). Each iteration runs a Riccati recursion backwards over the linearised model, where an input at its
//! limit has no feedback, then a roll-out of the nonlinear model with the inputs clamped to their limits, with a line search
//! on the cost. Every roll-out is feasible, so the result is feasible at any number of iterations.
//!
//! **Limits.** Forward motion only. Where the limits of the drive are active for long, clamping makes the result slower than
//! optimal. Gaps in the log are interpolated.

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
    /// One state for each time step of the file, from the initial time step of the problem.
    pub states: Vec<KinematicState>,
    /// Largest distance between the centres of the model and of the simulated vehicle at a time step, m.
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

/// Deviations of equal cost, which weight the terms of the objective.
mod sigma {
    /// Of the centre, m.
    pub(super) const POSITION: f64 = 0.01;
    /// Of the heading, rad: the order of slip angles.
    pub(super) const HEADING: f64 = 0.05;
    /// Of the speed, m/s.
    pub(super) const SPEED: f64 = 0.5;
    /// Steering rate, rad/s: large, for regularisation only.
    pub(super) const STEERING_RATE: f64 = 2.0;
    /// Acceleration, m/s².
    pub(super) const ACCELERATION: f64 = 20.0;
}

/// Most iterations; runs of 20 s take about ten.
const MAX_ITERATIONS: usize = 60;

/// First and largest damping: additional weight of the inputs, as a multiple of the given one, if no step reduces the cost.
const DAMPING: std::ops::Range<f64> = 1.0..1e9;

/// Relative reduction of the cost below which the iteration ends.
const CONVERGED: f64 = 1e-7;

/// Fits the model to a driven log.
///
/// The first state is the initial one of the problem, with the steering angle of the log, since files have none. The last
/// state is at `last_time_step`. If the log ends earlier, or has a number that is not finite, its last valid sample is the
/// reference from there on. An empty log gives only the initial state.
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
    let reference: Vec<Reference> = (0..=steps)
        .map(|k| Reference::at(samples, vehicle, (first + k as i64) as f64 * scenario.time_step, origin))
        .collect();
    let model = Model::new(vehicle, scenario.time_step);
    let steering = samples.first().map_or(0.0, |s| s.steering);
    let start = model.start(&problem.initial, steering);
    let states = Fitter { model: &model, reference: &reference }.solve(start, steps);
    let deviation = |(z, r): (&Vector5<f64>, &Reference)| (model.centre(z) - r.centre).norm();
    #[allow(clippy::cast_possible_wrap)] // a count of states in memory
    let state = |(k, z): (usize, &Vector5<f64>)| KinematicState {
        time_step: first + k as i64,
        centre: Pose { position: origin + model.centre(z).coords, yaw: z[PSI] },
        speed: z[V],
        steering: z[model::DELTA],
    };
    let max_deviation_m =
        if samples.is_empty() { 0.0 } else { states.iter().zip(&reference).map(deviation).fold(0.0, f64::max) };
    KinematicFit { states: states.iter().enumerate().map(state).collect(), max_deviation_m }
}

/// Whether the values that the fit uses are finite.
fn is_finite(s: &Sample) -> bool {
    [s.time, s.pose.position.x, s.pose.position.y, s.pose.yaw, s.speed, s.steering].iter().all(|v| v.is_finite())
}

/// Centre, heading and speed of the log at a time step, relative to the initial position.
struct Reference {
    centre: Point,
    yaw: f64,
    speed: f64,
}

impl Reference {
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
    reference: &'a [Reference],
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
            if gain <= CONVERGED * cost {
                break;
            }
            damping = if damping > DAMPING.start { damping * 0.1 } else { 0.0 };
        }
        states
    }

    /// A roll-out that follows speed and heading of the reference: close enough for the first linearisation.
    fn first_guess(&self, start: Vector5<f64>, inputs: &mut [Vector2<f64>]) -> Vec<Vector5<f64>> {
        let mut states = vec![start];
        for (input, next) in inputs.iter_mut().zip(&self.reference[1..]) {
            let z = states[states.len() - 1];
            *input = self.model.clamp(&z, self.model.towards(&z, next.yaw, next.speed));
            states.push(self.model.step(&z, input));
        }
        states
    }

    /// Weighted deviations of a state: centre (2), heading, speed.
    fn residual(&self, z: &Vector5<f64>, reference: &Reference) -> nalgebra::Vector4<f64> {
        let position = (self.model.centre(z) - reference.centre) / sigma::POSITION;
        let heading = wrap_angle(z[PSI] - reference.yaw) / sigma::HEADING;
        nalgebra::Vector4::new(position.x, position.y, heading, (z[V] - reference.speed) / sigma::SPEED)
    }

    fn cost(&self, states: &[Vector5<f64>], inputs: &[Vector2<f64>]) -> f64 {
        let deviations: f64 = states.iter().zip(self.reference).map(|(z, r)| self.residual(z, r).norm_squared()).sum();
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
        let residual = self.residual(&states[k], &self.reference[k]);
        (jacobian.transpose() * residual, jacobian.transpose() * jacobian)
    }

    /// Line search: the first roll-out with a lower cost, with the step halved each time.
    fn search(&self, states: &[Vector5<f64>], inputs: &[Vector2<f64>], gains: &[Gain], cost: f64) -> Option<RollOut> {
        /// Most step sizes; after that, damping is more effective.
        const HALVINGS: i32 = 5;
        (0..HALVINGS).find_map(|halvings| {
            let ratio = 0.5_f64.powi(halvings);
            let mut rolled = vec![states[0]];
            let mut chosen = Vec::with_capacity(inputs.len());
            for (k, gain) in gains.iter().enumerate() {
                let z = rolled[k];
                let unlimited = inputs[k] + gain.constant * ratio + gain.feedback * (z - states[k]);
                let u = self.model.clamp(&z, unlimited);
                rolled.push(self.model.step(&z, &u));
                chosen.push(u);
            }
            let new_cost = self.cost(&rolled, &chosen);
            (new_cost < cost).then_some((rolled, chosen, new_cost))
        })
    }
}

/// The change of input that minimises ½ uᵀ Q_uu u + uᵀ Q_u inside a box, and the feedback of the inputs that are not at a
/// limit. It is the unlimited minimum if that is inside the box, else the best minimum on an edge of the box.
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

/// The solution file with model KS and cost function SM1. `None` for a vehicle without a CommonRoad type.
#[must_use]
pub fn to_xml(scenario: &Scenario, problem: &PlanningProblem, vehicle: &Vehicle, fit: &KinematicFit) -> Option<String> {
    let kind = vehicle.commonroad_type?;
    let id = format!("KS{kind}:SM1:{}:{}", scenario.id, scenario.version);
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Writing to a String cannot fail.
    let _ = writeln!(xml, "<CommonRoadSolution benchmark_id=\"{}\">", escaped(&id));
    // The format allows headings within one turn: full turns of the first heading are subtracted from all.
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

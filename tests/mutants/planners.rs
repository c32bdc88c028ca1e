//! Planners with one fault each: wrong inputs, or changed outputs.

use std::collections::VecDeque;

use stopline::drive::{MotionPlanner, Observer, PredictionMode, Settings};
use stopline::geometry::polyline::Polyline;
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose};
use stopline::map::{GoalPosition, Motion, Part, Scenario, TimedPose};
use stopline::planner::{Cycle, Decision, Level, Observation, Plan, Planner, PlannerError};
use stopline::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
use stopline::vehicle::{Footprint, Vehicle};

/// The inputs of a mutated planner.
#[derive(Clone)]
pub(crate) struct Belief {
    pub(crate) scenario: Scenario,
    pub(crate) vehicle: Vehicle,
    pub(crate) settings: Settings,
}

pub(crate) fn no_obstacles(belief: &mut Belief) {
    belief.scenario.obstacles.clear();
}

pub(crate) fn a_fifth_as_wide(belief: &mut Belief) {
    let v = &mut belief.vehicle;
    v.width *= 0.2;
    v.footprint = Footprint::rectangle(v.length, v.width, v.rear_axle_to_centre);
}

/// The footprint is centred on the rear axle, 1.4 m too far back.
pub(crate) fn centre_for_rear_axle(belief: &mut Belief) {
    let v = &mut belief.vehicle;
    v.rear_axle_to_centre = 0.0;
    v.footprint = Footprint::rectangle(v.length, v.width, 0.0);
}

/// Moving obstacles stay at their first position.
pub(crate) fn frozen_predictions(belief: &mut Belief) {
    for o in &mut belief.scenario.obstacles {
        if let Motion::Trajectory(states) = &o.motion {
            o.motion = Motion::Static(states[0].pose);
        }
    }
}

/// Moving obstacles keep their first velocity.
pub(crate) fn constant_velocity(belief: &mut Belief) {
    for o in &mut belief.scenario.obstacles {
        if let Motion::Trajectory(states) = &mut o.motion {
            let first = states[0];
            for s in states {
                s.pose = first.pose.advanced(first.speed * (s.time - first.time));
                s.speed = first.speed;
            }
        }
    }
}

/// Predictions are four seconds old.
pub(crate) fn stale_predictions(belief: &mut Belief) {
    const AGE: f64 = 4.0;
    for o in &mut belief.scenario.obstacles {
        if let Motion::Trajectory(states) = &mut o.motion {
            let first = states[0];
            states.iter_mut().for_each(|s| s.time += AGE);
            states.insert(0, TimedPose { ..first });
        }
    }
}

/// Predictions are one second early.
pub(crate) fn early_predictions(belief: &mut Belief) {
    for o in &mut belief.scenario.obstacles {
        if let Motion::Trajectory(states) = &mut o.motion {
            let last = states[states.len() - 1];
            states.iter_mut().for_each(|s| s.time -= 1.0);
            states.push(TimedPose { pose: last.pose.advanced(last.speed), ..last });
        }
    }
}

/// What is seen is two seconds old, and moves on with constant velocity.
pub(crate) fn old_observation(belief: &mut Belief) {
    belief.settings.observation.prediction = PredictionMode::ConstantVelocity;
    belief.settings.observation.sensor.delay = 2.0;
}

/// Predictions end after a second, and obstacles with them.
pub(crate) fn dropped_after_a_second(belief: &mut Belief) {
    belief.settings.planner.extrapolation.duration = 0.0;
    for o in &mut belief.scenario.obstacles {
        if let Motion::Trajectory(states) = &mut o.motion {
            let begins = states[0].time;
            states.retain(|s| s.time <= begins + 1.0);
        }
    }
}

/// The road is believed to be dry.
pub(crate) fn dry_road(belief: &mut Belief) {
    belief.settings.simulation.friction_scale = 1.0;
}

pub(crate) fn constant_velocity_prediction(belief: &mut Belief) {
    belief.settings.observation.prediction = PredictionMode::ConstantVelocity;
}

/// The vehicle is believed to follow its plans twice as closely.
pub(crate) fn half_the_tube(belief: &mut Belief) {
    let tube = &mut belief.vehicle.tracking;
    for bound in [&mut tube.lateral, &mut tube.longitudinal, &mut tube.heading].into_iter().flatten() {
        *bound *= 0.5;
    }
}

pub(crate) fn twice_the_comfort(belief: &mut Belief) {
    let c = &mut belief.vehicle.comfort;
    for limit in [
        &mut c.acceleration,
        &mut c.deceleration,
        &mut c.aggressive_deceleration,
        &mut c.lateral_acceleration,
        &mut c.jerk,
    ] {
        *limit *= 2.0;
    }
}

pub(crate) fn any_lateral_acceleration(belief: &mut Belief) {
    belief.vehicle.comfort.lateral_acceleration = 30.0;
}

/// The planner may steer farther than the vehicle can.
pub(crate) fn any_curvature(belief: &mut Belief) {
    belief.vehicle.limits.steering = 1.0;
}

/// A goal forty metres before the true one.
pub(crate) fn another_goal(belief: &mut Belief) {
    for goal in &mut belief.scenario.problems[0].goals {
        let Some(GoalPosition::Shapes(shape)) = &mut goal.position else { panic!("a goal without a region") };
        for part in &mut shape.parts {
            let Part::Rectangle { centre, .. } = part else { panic!("a goal that is not a rectangle") };
            *centre = centre.advanced(-40.0);
        }
    }
}

/// The road is three metres wider on both sides.
pub(crate) fn wider_road(belief: &mut Belief) {
    const MORE: f64 = 3.0;
    let moved = |line: &Polyline, side: f64| {
        let yaw = |p: &[Point]| (p[1] - p[0]).y.atan2((p[1] - p[0]).x);
        let points = line.points();
        let out = points.iter().enumerate().map(|(i, p)| {
            let i = i.min(points.len() - 2);
            Pose { position: *p, yaw: yaw(&points[i..i + 2]) }.to_world(Point::new(0.0, side * MORE))
        });
        Polyline::new(out).unwrap()
    };
    for lanelet in belief.scenario.network.lanelets.values_mut() {
        lanelet.left = moved(&lanelet.left, 1.0);
        lanelet.right = moved(&lanelet.right, -1.0);
    }
}

/// The real planner with its own observations.
pub(crate) struct Believer<'a> {
    pub(crate) planner: Planner<'a>,
    pub(crate) observer: Observer<'a>,
}

impl<'a> Believer<'a> {
    pub(crate) fn new(belief: &'a Belief) -> Self {
        let Belief { scenario, vehicle, settings } = belief;
        Self {
            planner: Planner::new(scenario.map(), vehicle, &settings.planner).unwrap(),
            observer: Observer::new(scenario, &scenario.problems[0], vehicle, settings),
        }
    }

    fn cycle(&mut self, true_one: &Observation) -> Result<Cycle, PlannerError> {
        self.planner.traced_cycle(&self.observer.observe(&true_one.state))
    }
}

/// The real planner with changed plans.
pub(crate) struct Changed<'a> {
    pub(crate) planner: Believer<'a>,
    pub(crate) change: fn(&mut Cycle),
}

impl MotionPlanner for Changed<'_> {
    fn cycle(&mut self, observation: &Observation) -> Result<Cycle, PlannerError> {
        let mut cycle = self.planner.cycle(observation)?;
        (self.change)(&mut cycle);
        Ok(cycle)
    }
}

/// The real planner with plans that are some cycles late, with the time of new ones.
pub(crate) struct Late<'a> {
    pub(crate) planner: Believer<'a>,
    pub(crate) waiting: VecDeque<Trajectory>,
}

impl Late<'_> {
    pub(crate) const CYCLES: usize = 8;
}

impl MotionPlanner for Late<'_> {
    fn cycle(&mut self, observation: &Observation) -> Result<Cycle, PlannerError> {
        let mut cycle = self.planner.cycle(observation)?;
        self.waiting.push_back(cycle.plan.trajectory.clone());
        if self.waiting.len() > Self::CYCLES {
            self.waiting.pop_front();
        }
        if let Some(old) = self.waiting.front() {
            let age = (self.waiting.len() - 1) as f64 * 0.1;
            cycle.plan.trajectory = Trajectory { start_time: old.start_time + age, ..old.clone() };
        }
        Ok(cycle)
    }
}

/// The real planner, called once.
pub(crate) struct Once<'a> {
    pub(crate) planner: Believer<'a>,
    pub(crate) first: Option<Cycle>,
}

impl MotionPlanner for Once<'_> {
    fn cycle(&mut self, observation: &Observation) -> Result<Cycle, PlannerError> {
        Ok(match &self.first {
            Some(Cycle { plan, trace }) => {
                let plan = Plan { time: observation.state.time, decision: Decision::KeepPrevious, ..plan.clone() };
                Cycle { plan, trace: trace.clone() }
            }
            None => self.first.insert(self.planner.cycle(observation)?).clone(),
        })
    }
}

/// No change.
pub(crate) fn unchanged(_: &mut Cycle) {}

/// The knots of the profile up to some seconds from now.
fn cut(cycle: &Cycle, seconds: f64) -> Vec<SpeedKnot> {
    let profile = &cycle.plan.trajectory.profile;
    let end = cycle.plan.time - cycle.plan.trajectory.start_time + seconds;
    let mut knots: Vec<SpeedKnot> = profile.knots().iter().filter(|k| k.time < end - 1e-6).copied().collect();
    if profile.last().time > end {
        knots.push(profile.at(end));
    }
    knots
}

/// Two seconds ahead the plan stops within a twentieth of a second.
pub(crate) fn stop_proof_skipped(cycle: &mut Cycle) {
    const INSTANT: f64 = 0.05;
    let mut knots = cut(cycle, 2.0);
    let last = knots.len() - 1;
    let k = knots[last];
    if k.speed > 0.0 {
        knots[last] = SpeedKnot { acceleration: -k.speed / INSTANT, jerk: 0.0, ..k };
        let (time, station) = (k.time + INSTANT, k.station + 0.5 * k.speed * INSTANT);
        knots.push(SpeedKnot { time, station, speed: 0.0, acceleration: 0.0, jerk: 0.0 });
    }
    cycle.plan.trajectory.profile = SpeedProfile::new(knots).unwrap();
}

/// The plan ends moving.
pub(crate) fn never_stops(cycle: &mut Cycle) {
    let knots = cut(cycle, 3.0);
    cycle.plan.trajectory.profile = SpeedProfile::new(knots).unwrap();
}

/// One second ahead the plan keeps its speed for eight metres and stops as planned after that.
pub(crate) fn stops_too_late(cycle: &mut Cycle) {
    const FARTHER: f64 = 8.0;
    let profile = cycle.plan.trajectory.profile.clone();
    let mut knots = cut(cycle, 1.0);
    let k = knots[knots.len() - 1];
    if k.speed < 1.0 || !cycle.plan.trajectory.profile.ends_at_standstill() {
        return;
    }
    let lasts = FARTHER / k.speed;
    let last = knots.len() - 1;
    knots[last] = SpeedKnot { acceleration: 0.0, jerk: 0.0, ..k };
    let shifted = |s: SpeedKnot| SpeedKnot { time: s.time + lasts, station: s.station + FARTHER, ..s };
    knots.push(shifted(k));
    knots.extend(profile.knots().iter().filter(|s| s.time > k.time + 1e-6).map(|s| shifted(*s)));
    // the path is extended straight ahead
    let path = &cycle.plan.trajectory.path;
    let mut spirals: Vec<CubicSpiral> = path.pieces().map(|(_, _, s)| *s).collect();
    spirals.push(CubicSpiral { knots: [0.0; 4], length: FARTHER + 1.0 });
    let start = path.at(0.0).pose;
    cycle.plan.trajectory.path = Path::new(start, &spirals).unwrap();
    cycle.plan.trajectory.profile = SpeedProfile::new(knots).unwrap();
}

/// The record claims gentler braking than the plan has.
pub(crate) fn deceleration_understated(cycle: &mut Cycle) {
    if cycle.plan.decision == Decision::NewPlan {
        let deceleration = &mut cycle.plan.deceleration;
        *deceleration = 0.5;
    }
}

/// The record of a proven plan claims the gentlest level.
pub(crate) fn gentlest_level(cycle: &mut Cycle) {
    if cycle.plan.level.is_proven() {
        cycle.plan.level = Level::Comfort;
    }
}

/// The plan is half a second early.
pub(crate) fn half_a_second_early(cycle: &mut Cycle) {
    cycle.plan.trajectory.start_time -= 0.5;
}

pub(crate) fn aside(cycle: &mut Cycle) {
    let start = cycle.plan.trajectory.path.at(0.0).pose;
    let spirals: Vec<CubicSpiral> = cycle.plan.trajectory.path.pieces().map(|(_, _, s)| *s).collect();
    let moved = Pose { position: start.to_world(Point::new(0.0, 0.3)), yaw: start.yaw };
    cycle.plan.trajectory.path = Path::new(moved, &spirals).unwrap();
}

/// Left for right.
pub(crate) fn mirrored(cycle: &mut Cycle) {
    let start = cycle.plan.trajectory.path.at(0.0).pose;
    let mirror = |s: &CubicSpiral| CubicSpiral { knots: s.knots.map(|k| -k), length: s.length };
    let spirals: Vec<CubicSpiral> = cycle.plan.trajectory.path.pieces().map(|(_, _, s)| mirror(s)).collect();
    cycle.plan.trajectory.path = Path::new(start, &spirals).unwrap();
}

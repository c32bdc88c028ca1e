//! The vehicle's motion as pictures show it: the log of the simulation, or the plan if nothing was driven.

use crate::drive::Run;
use crate::geometry::Pose;
use crate::map::RoadNetwork;
use crate::simulation::Sample;
use crate::verdict::{self, zero_phase_low_pass};

/// Motion over time.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    /// In order of time; empty without a log and a plan.
    pub(crate) samples: Vec<MotionSample>,
    /// Whether the motion was driven; otherwise it is the committed plan of the first cycle.
    pub(crate) driven: bool,
}

/// Motion at one instant. Every number is finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotionSample {
    /// Time of the run, s.
    pub(crate) time: f64,
    /// Rear-axle pose.
    pub(crate) pose: Pose,
    /// Speed along the heading, m/s.
    pub(crate) speed: f64,
    /// Reference speed, m/s.
    pub(crate) reference_speed: f64,
    /// Longitudinal acceleration, m/s².
    pub(crate) acceleration: f64,
    /// Lateral acceleration, m/s², left positive.
    pub(crate) lateral_acceleration: f64,
    /// Longitudinal jerk, m/s³: derivative of the filtered acceleration, as in the verdict.
    pub(crate) jerk: f64,
    /// Steering angle, rad.
    pub(crate) steering: f64,
    /// Commanded steering angle, rad.
    pub(crate) reference_steering: f64,
}

/// Spacing at which a plan is sampled, s.
const PLAN_STEP: f64 = 0.05;

impl Motion {
    /// The motion of a run.
    pub(crate) fn of(run: &Run) -> Self {
        let log: Vec<Sample> = run.log.samples.iter().filter(|s| is_finite(s)).copied().collect();
        if log.is_empty() {
            return Self { samples: planned(run), driven: false };
        }
        let jerk = filtered_jerk(&log);
        let samples = log.iter().zip(jerk).map(|(s, jerk)| of_sample(s, jerk)).collect();
        Self { samples, driven: true }
    }

    /// Time interval of the motion, s; `(0, 0)` for an empty motion.
    pub(crate) fn time_range(&self) -> (f64, f64) {
        match (self.samples.first(), self.samples.last()) {
            (Some(first), Some(last)) => (first.time, last.time),
            _ => (0.0, 0.0),
        }
    }

    /// The sample at or just before `time`; the first one before the start.
    pub(crate) fn at(&self, time: f64) -> Option<&MotionSample> {
        // times are products of step and count: allow for rounding
        let after = self.samples.partition_point(|s| s.time <= time + 1e-9);
        self.samples.get(after.max(1) - 1)
    }

    /// Samples at least `spacing` seconds apart, the first and the last included.
    pub(crate) fn thinned(&self, spacing: f64) -> Vec<MotionSample> {
        let mut kept: Vec<MotionSample> = Vec::new();
        for (i, sample) in self.samples.iter().enumerate() {
            let due = kept.last().is_none_or(|last| sample.time - last.time >= spacing - 1e-9);
            if due || i + 1 == self.samples.len() {
                kept.push(*sample);
            }
        }
        kept
    }

    /// Times from the start to the end of the motion, `spacing` seconds apart, the end included.
    pub(crate) fn ticks(&self, spacing: f64) -> Vec<f64> {
        if self.samples.is_empty() {
            return Vec::new();
        }
        let (from, to) = self.time_range();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count
        let whole = ((to - from) / spacing + 1e-9).floor() as usize;
        let mut ticks: Vec<f64> = (0..=whole).map(|i| from + i as f64 * spacing).collect();
        if ticks.last().is_some_and(|last| to - last > 1e-6) {
            ticks.push(to);
        }
        ticks
    }
}

/// The lowest speed limit posted on a lanelet at the position, m/s.
pub(crate) fn speed_limit_at(network: &RoadNetwork, pose: &Pose) -> Option<f64> {
    network
        .lanelets
        .values()
        .filter(|l| l.speed_limit.is_some() && l.contains(pose.position))
        .filter_map(|l| l.speed_limit)
        .min_by(f64::total_cmp)
}

fn planned(run: &Run) -> Vec<MotionSample> {
    let Some(cycle) = run.cycles.first() else { return Vec::new() };
    let plan = &cycle.plan.trajectory;
    let (from, to) = (cycle.plan.time.max(plan.start_time), plan.end_time().max(cycle.plan.time));
    let steps = ((to - from) / PLAN_STEP).ceil().clamp(1.0, 100_000.0);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped above
    (0..=steps as usize)
        .map(|i| plan.at(from + (to - from) * i as f64 / steps))
        .filter(|p| p.pose.position.coords.iter().all(|c| c.is_finite()) && p.speed.is_finite())
        .map(|p| {
            let steering = run.vehicle.steering_for_curvature(p.curvature);
            MotionSample {
                time: p.time,
                pose: p.pose,
                speed: p.speed,
                reference_speed: p.speed,
                acceleration: p.acceleration,
                lateral_acceleration: p.curvature * p.speed * p.speed,
                jerk: p.jerk,
                steering,
                reference_steering: steering,
            }
        })
        .collect()
}

fn of_sample(s: &Sample, jerk: f64) -> MotionSample {
    MotionSample {
        time: s.time,
        pose: s.pose,
        speed: s.speed,
        reference_speed: s.reference_speed,
        acceleration: s.acceleration,
        lateral_acceleration: s.lateral_acceleration,
        jerk,
        steering: s.steering,
        reference_steering: s.commanded_steering,
    }
}

fn is_finite(s: &Sample) -> bool {
    let numbers = [
        s.time,
        s.pose.position.x,
        s.pose.position.y,
        s.pose.yaw,
        s.speed,
        s.reference_speed,
        s.acceleration,
        s.lateral_acceleration,
        s.steering,
        s.commanded_steering,
    ];
    numbers.iter().all(|n| n.is_finite())
}

/// Jerk at each sample: central differences of the filtered acceleration, as in the verdict's `comfort_jerk`.
fn filtered_jerk(log: &[Sample]) -> Vec<f64> {
    let (Some(first), Some(last)) = (log.first(), log.last()) else { return Vec::new() };
    let rate = (log.len() - 1) as f64 / (last.time - first.time);
    let filtered: Vec<f64> = log.iter().map(|s| s.acceleration).collect();
    let cutoff = verdict::Settings::default().comfort_cutoff;
    let filtered = if rate.is_finite() { zero_phase_low_pass(&filtered, cutoff, rate) } else { filtered };
    (0..log.len())
        .map(|i| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(log.len() - 1));
            let step = log[after].time - log[before].time;
            if step > 0.0 { (filtered[after] - filtered[before]) / step } else { 0.0 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::example::Example;

    #[test]
    fn jerk_of_a_ramp_in_acceleration_is_its_slope() {
        let example = Example::new();
        let mut samples = example.run().log.samples;
        for s in &mut samples {
            s.acceleration = 0.3 - 1.7 * s.time;
        }
        let jerk = filtered_jerk(&samples);
        // the filter assumes constant values beyond the ends
        let inner = &jerk[100..jerk.len() - 100];
        assert!(inner.iter().all(|j| (j + 1.7).abs() < 1e-3), "{inner:?}");
        assert_eq!(filtered_jerk(&samples[..1]), [0.0]);
    }

    #[test]
    fn without_a_log_the_plan_is_shown() {
        let example = Example::new();
        let mut run = example.run();
        run.log.samples.clear();
        let motion = Motion::of(&run);
        assert!(!motion.driven);
        let plan = &run.cycles[0].plan.trajectory;
        let (from, to) = motion.time_range();
        assert_eq!(from, plan.start_time);
        assert!((to - plan.end_time()).abs() < 1e-9);
        assert!(motion.samples[motion.samples.len() - 1].speed < 1e-9);
        run.cycles.clear();
        assert!(Motion::of(&run).samples.is_empty());
        assert!(Motion::of(&run).ticks(0.5).is_empty());
    }

    #[test]
    fn invalid_samples_are_omitted() {
        let example = Example::new();
        let mut run = example.run();
        let count = run.log.samples.len();
        run.log.samples[3].speed = f64::NAN;
        run.log.samples[5].pose.position.x = f64::INFINITY;
        assert_eq!(Motion::of(&run).samples.len(), count - 2);
    }

    #[test]
    fn ticks_include_the_end() {
        let example = Example::new();
        let motion = Motion::of(&example.run());
        let (from, to) = motion.time_range();
        let ticks = motion.ticks(0.7);
        assert_eq!((ticks[0], ticks[ticks.len() - 1]), (from, to));
        assert!(ticks.windows(2).all(|w| w[1] > w[0]));
    }
}

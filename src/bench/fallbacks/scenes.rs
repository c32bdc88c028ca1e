//! Random scenes from a seed: what a fallback stop has to survive.
//!
//! A scene is a scenario with one planning problem, made for one vehicle: lane widths, gaps and speeds follow from its width,
//! its stopping distance and its top speed, so that the same kinds of scene ask as much of a robot car as of a truck. Each
//! scene depends on its seed and its number alone. Generator of random numbers: splitmix64.
//!
//! The kinds cover what local planners are known to fail at: a wall or a parked car at and below the stopping distance, gaps
//! hardly wider than the vehicle, tight bends with and without a sidewalk beside them, a leader that brakes, a car that cuts in,
//! crossing and oncoming traffic, a lane that ends beside a passing car. Scenes may have no solution: what is counted is
//! whether a plan that claims to be proven is.
//!
//! Weak where: roads are made of straights and arcs, at most two lanes wide; obstacles keep their lane or cross it in a straight
//! line; everything moves as predicted.

use std::f64::consts::{FRAC_PI_2, TAU};

use crate::fixtures;
use crate::geometry::Pose;
use crate::geometry::polyline::Polyline;
use crate::map::{
    Goal, GoalPosition, InitialState, Interval, Lanelet, LaneletId, Motion, Neighbour, Obstacle, ObstacleKind, Part,
    PlanningProblem, Scenario, Shape, TimedPose,
};
use crate::vehicle::Vehicle;

/// Kinds of scene; scene `n` is of kind `n` modulo their number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// A wall over the whole road, near the stopping distance.
    Wall,
    /// A parked car over part of the lane; the lane beside it is free or missing.
    ParkedCar,
    /// Two posts with a gap between them.
    Gap,
    /// A bend, with a sidewalk beside it in half of the scenes.
    Bend,
    /// A leader that brakes to standstill.
    Leader,
    /// A car that changes from the left lane to ours.
    CutIn,
    /// A car that crosses our lane.
    Crossing,
    /// An oncoming car that takes part of our lane.
    Oncoming,
    /// Our lane ends, a car drives on the other one.
    LaneEnd,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 9] = [
        Self::Wall,
        Self::ParkedCar,
        Self::Gap,
        Self::Bend,
        Self::Leader,
        Self::CutIn,
        Self::Crossing,
        Self::Oncoming,
        Self::LaneEnd,
    ];

    /// The stable name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Wall => "wall",
            Self::ParkedCar => "parked_car",
            Self::Gap => "gap",
            Self::Bend => "bend",
            Self::Leader => "leader",
            Self::CutIn => "cut_in",
            Self::Crossing => "crossing",
            Self::Oncoming => "oncoming",
            Self::LaneEnd => "lane_end",
        }
    }
}

/// A scene.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Its kind.
    pub kind: Kind,
    /// The scenario, with one planning problem.
    pub scenario: Scenario,
}

impl Scene {
    /// Scene `number` of a seed for a vehicle on a road whose friction is `friction` times that of its tyres on dry asphalt.
    #[must_use]
    pub fn new(seed: u64, number: u64, vehicle: &Vehicle, friction: f64) -> Self {
        #[allow(clippy::cast_possible_truncation)] // below the number of kinds
        let kind = Kind::ALL[(number % Kind::ALL.len() as u64) as usize];
        let mut maker = Maker::new(seed, number, vehicle, friction);
        maker.make(kind);
        Self { kind, scenario: maker.finish(kind, number) }
    }
}

/// Random numbers (splitmix64: Steele, Lea & Flood 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Evenly distributed over `[low, high)`.
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn chance(&mut self, share: f64) -> bool {
        self.within(0.0, 1.0) < share
    }

    fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
}

/// Fastest start, m/s. Starts are within the speeds of the tracking tube, beyond which nothing is ever proven.
const TOP_SPEED: f64 = 25.0;
/// Time that predictions last, s.
const PREDICTED: f64 = 25.0;
/// Time between two predicted states, s.
const TIME_STEP: f64 = 0.1;
/// Deadline of the goal, s.
const DEADLINE: f64 = 20.0;
/// Width of the car by whose size scenes are scaled, m.
const CAR_WIDTH: f64 = 1.7;
/// Deceleration on dry asphalt that distances are laid out for, m/s²: a firm stop.
const FIRM: f64 = 4.0;

/// A scene in the making.
struct Maker<'v> {
    random: Random,
    vehicle: &'v Vehicle,
    /// Size of things, relative to those of a car.
    scale: f64,
    /// Width of a lane, m.
    lane: f64,
    /// Speed at the start, m/s.
    speed: f64,
    /// Distance of a firm stop from there, m.
    stopping: f64,
    /// The road's centre line: a pose every metre or so, with its station.
    line: Vec<(f64, Pose)>,
    lanelets: Vec<Lanelet>,
    obstacles: Vec<Obstacle>,
    /// Lateral position of the start and of the goal, m.
    offsets: (f64, f64),
    stops_at_goal: bool,
}

impl<'v> Maker<'v> {
    fn new(seed: u64, number: u64, vehicle: &'v Vehicle, friction: f64) -> Self {
        let mut random = Random(seed ^ number.wrapping_mul(0xD134_2543_DE82_EF95));
        let scale = (vehicle.width / CAR_WIDTH).min(1.0);
        let lane = vehicle.width + scale * random.within(0.9, 2.0);
        let fastest = TOP_SPEED.min(0.8 * vehicle.limits.speed).min(vehicle.tracking.speed[0]);
        let speed = if random.chance(0.1) { 0.0 } else { random.within(0.0, fastest) };
        let stopping = speed * speed / (2.0 * FIRM * friction.min(1.0));
        Self {
            random,
            vehicle,
            scale,
            lane,
            speed,
            stopping,
            line: Vec::new(),
            lanelets: Vec::new(),
            obstacles: Vec::new(),
            offsets: (0.0, 0.0),
            stops_at_goal: false,
        }
    }

    fn make(&mut self, kind: Kind) {
        self.stops_at_goal = self.random.chance(0.5);
        match kind {
            Kind::Wall => self.wall(),
            Kind::ParkedCar => self.parked_car(),
            Kind::Gap => self.gap(),
            Kind::Bend => self.bend(),
            Kind::Leader => self.leader(),
            Kind::CutIn => self.cut_in(),
            Kind::Crossing => self.crossing(),
            Kind::Oncoming => self.oncoming(),
            Kind::LaneEnd => self.lane_end(),
        }
    }

    fn wall(&mut self) {
        let lanes = if self.random.chance(0.5) { 1 } else { 2 };
        self.gentle_road(lanes);
        let distance = self.ahead(0.6, 2.5);
        let width = 3.0 * self.lane * f64::from(lanes);
        self.fixed(distance, 0.0, 0.5 * self.scale, width);
    }

    fn parked_car(&mut self) {
        let lanes = if self.random.chance(0.7) { 2 } else { 1 };
        self.gentle_road(lanes);
        let (length, width) = (self.sized(3.8, 5.0), self.sized(1.6, 2.0));
        let offset = self.random.within(-1.2, 0.4) * self.scale;
        let distance = self.ahead(0.5, 3.0) + 0.5 * length;
        self.fixed(distance, offset, length, width);
        if self.random.chance(0.3) {
            let (further, beside) = (self.sized(8.0, 30.0), self.lane * self.random.within(0.6, 1.2));
            self.fixed(distance + further, beside, length, width);
        }
    }

    fn gap(&mut self) {
        self.lane = self.lane.max(self.vehicle.width + 2.0 * self.scale);
        self.gentle_road(1);
        let gap = self.vehicle.width + self.scale * self.random.within(0.05, 1.2);
        let middle = self.random.within(-0.5, 0.5) * (self.lane - gap).max(0.0);
        let post = self.sized(0.3, 1.0);
        let distance = self.ahead(0.5, 3.0);
        for side in [-1.0, 1.0] {
            self.fixed(distance, middle + side * 0.5 * (gap + post), post, post);
        }
    }

    fn bend(&mut self) {
        let least = self.vehicle.wheelbase / self.vehicle.limits.steering.tan();
        let radius = least * self.random.within(1.3, 6.0) + 0.5 * self.lane;
        // a start within twice what the bend allows at 3 m/s²
        self.speed = self.speed.min(2.0 * (3.0 * radius).sqrt());
        let before = self.ahead(0.3, 1.5);
        let turn = self.random.sign() / radius;
        let angle = self.random.within(0.5, 2.2);
        let then = self.random.sign() * self.random.within(0.0, 1.0) / radius;
        self.road(&[(before, 0.0), (angle * radius, turn), (self.scale * 15.0, then), (self.scale * 40.0, 0.0)], 1);
        if self.random.chance(0.5) {
            self.sidewalks();
        }
        if self.random.chance(0.3) {
            let station = before + angle * radius * self.random.within(0.3, 1.2);
            let offset = self.random_offset(0.8);
            self.fixed(station, offset, self.scale, self.scale);
        }
    }

    fn leader(&mut self) {
        let lanes = if self.random.chance(0.3) { 2 } else { 1 };
        self.gentle_road(lanes);
        let gap = self.sized(0.3, 4.0) + self.random.within(0.0, 2.0) * self.speed;
        let speed = self.speed * self.random.within(0.3, 1.2);
        let (begins, braking) = (self.random.within(0.0, 5.0), self.random.within(1.0, 8.0));
        let drives_on = self.random.chance(0.4).then(|| self.random.within(1.0, 5.0));
        let length = self.sized(3.8, 5.0);
        let from = self.start() + self.front() + gap + 0.5 * length;
        let (offset, width) = (self.random_offset(0.3), self.sized(1.6, 2.0));
        let motion = speeds(speed, |t, v| match drives_on {
            _ if t < begins => 0.0,
            Some(wait) if t > begins + speed / braking + wait => 1.5,
            _ if v > 0.0 => -braking,
            _ => 0.0,
        });
        self.moving(from, &motion, |_| offset, (length, width));
    }

    fn cut_in(&mut self) {
        self.gentle_road(2);
        let gap = self.random.within(-0.5, 1.5) * self.speed + self.sized(-3.0, 10.0);
        let speed = (self.speed * self.random.within(0.5, 1.2)).max(0.5 * self.scale);
        let (begins, takes) = (self.random.within(0.0, 3.0), self.random.within(1.5, 4.0));
        let (length, width) = (self.sized(3.8, 5.0), self.sized(1.6, 2.0));
        let lane = self.lane;
        let brakes_from = begins + takes + self.random.within(0.0, 4.0);
        let braking = self.random.within(0.0, 4.0);
        let motion = speeds(speed, |t, v| if t > brakes_from && v > 0.0 { -braking } else { 0.0 });
        let offset = move |t: f64| {
            let share = ((t - begins) / takes).clamp(0.0, 1.0);
            lane * (0.5 + 0.5 * (0.5 * TAU * share).cos())
        };
        let from = (self.start() + self.front() + gap + 0.5 * length).max(0.6 * length);
        self.moving(from, &motion, offset, (length, width));
    }

    fn crossing(&mut self) {
        self.gentle_road(1);
        let distance = self.ahead(0.6, 3.0);
        let arrives = distance / self.speed.max(2.0 * self.scale);
        let speed = self.random.within(1.0, 12.0) * self.scale.max(0.3);
        let (length, width) = (self.sized(3.8, 5.0), self.sized(1.6, 2.0));
        let side = self.random.sign();
        let early = self.random.within(-2.0, 2.0);
        let at = self.at(self.start() + self.front() + distance, 0.0);
        let angle = at.yaw + side * (FRAC_PI_2 + self.random.within(-0.6, 0.6));
        let through = Pose { position: at.position, yaw: angle };
        let stops = self.random.chance(0.3);
        let states = (0..=steps()).map(|k| {
            let time = TIME_STEP * f64::from(k);
            let mut way = speed * (time - arrives + early);
            let mut v = speed;
            if stops && way > 0.0 {
                (way, v) = (0.0, 0.0);
            }
            TimedPose { time, pose: through.advanced(way), speed: v }
        });
        self.add(ObstacleKind::Vehicle, Shape::rectangle(length, width), Motion::Trajectory(states.collect()));
    }

    fn oncoming(&mut self) {
        self.gentle_road(2);
        // the left lane is the oncoming one
        for lanelet in &mut self.lanelets {
            if lanelet.id >= LEFT {
                *lanelet = reversed(lanelet);
            } else if let Some(left) = &mut lanelet.adjacent_left {
                left.same_direction = false;
            }
        }
        let speed = self.random.within(2.0, 15.0) * self.scale;
        let distance = self.ahead(1.0, 3.0) + speed * self.random.within(0.5, 4.0);
        let (length, width) = (self.sized(4.0, 12.0), self.sized(1.7, 2.5));
        let offset = self.lane - self.random.within(0.0, 0.6) * self.lane;
        let from = (self.start() + self.front() + distance).min(self.length() - length);
        let states: Vec<TimedPose> = (0..=steps())
            .map(|k| (TIME_STEP * f64::from(k), from - speed * TIME_STEP * f64::from(k)))
            .take_while(|(_, station)| *station > length)
            .map(|(time, station)| {
                let pose = self.at(station, offset);
                TimedPose { time, pose: Pose { yaw: pose.yaw + 0.5 * TAU, ..pose }, speed }
            })
            .collect();
        if !states.is_empty() {
            self.add(ObstacleKind::Vehicle, Shape::rectangle(length, width), Motion::Trajectory(states));
        }
        if self.random.chance(0.5) {
            let offset = self.random.within(-1.2, -0.2) * self.scale;
            let distance = self.ahead(0.6, 2.0);
            let size = (self.sized(3.8, 5.0), self.sized(1.6, 2.0));
            self.fixed(distance + 0.5 * size.0, offset, size.0, size.1);
        }
    }

    fn lane_end(&mut self) {
        let before = self.start() + self.front() + self.ahead(0.8, 3.0);
        let after = before + 60.0 * self.scale + 2.0 * self.stopping;
        self.curve(&[(after, 0.0)]);
        let (lane, half) = (self.lane, 0.5 * self.lane);
        self.lanelet(RIGHT, (0.0, before), -half, half);
        self.lanelet(LEFT, (0.0, before), half, half + lane);
        self.lanelet(LEFT + 1, (before, after), half, half + lane);
        self.beside(RIGHT, LEFT);
        self.follows(LEFT, LEFT + 1);
        self.offsets = (0.0, lane);
        let length = self.sized(3.8, 5.0);
        let gap = self.random.within(-1.0, 1.0) * self.speed + self.sized(-6.0, 10.0);
        let speed = (self.speed * self.random.within(0.6, 1.2)).max(self.scale);
        let from = (self.start() + self.front() + gap).max(0.6 * length);
        let width = self.sized(1.6, 2.0);
        self.moving(from, &speeds(speed, |_, _| 0.0), |_| lane, (length, width));
    }

    /// Distance ahead of the front bumper, m: shares of the stopping distance, and a few metres.
    fn ahead(&mut self, least: f64, most: f64) -> f64 {
        self.stopping * self.random.within(least, most) + self.sized(0.3, 12.0)
    }

    /// A length between two that fit a car, m.
    fn sized(&mut self, least: f64, most: f64) -> f64 {
        self.scale * self.random.within(least, most)
    }

    fn random_offset(&mut self, share: f64) -> f64 {
        self.random.within(-0.5, 0.5) * share * self.lane
    }

    /// Station of the start's rear axle, m.
    fn start(&self) -> f64 {
        2.0 * self.vehicle.length
    }

    /// From the rear axle to the front bumper, m.
    fn front(&self) -> f64 {
        self.vehicle.front_overhang_from_rear_axle()
    }

    fn length(&self) -> f64 {
        self.line.last().map_or(0.0, |(s, _)| *s)
    }

    /// A road that is long enough to stop on twice, straight or slightly bent.
    fn gentle_road(&mut self, lanes: u32) {
        let length = self.start() + 3.0 * self.stopping + 80.0 * self.scale;
        let lateral = self.random.within(-1.0, 1.0);
        let bent = self.random.chance(0.4);
        // 1 m/s² lateral at the start's speed, and no bend sharper than 30 m for a car
        let curvature = if bent { lateral / (self.speed * self.speed).max(30.0 * self.scale) } else { 0.0 };
        self.road(&[(0.3 * length, 0.0), (0.7 * length, curvature)], lanes);
    }

    /// A road of arcs (length, curvature), after the stretch behind the start; the first lane is about the centre line, the
    /// second one to its left.
    fn road(&mut self, arcs: &[(f64, f64)], lanes: u32) {
        let behind = [(self.start(), 0.0)];
        self.curve(&[&behind, arcs].concat());
        let (length, lane, half) = (self.length(), self.lane, 0.5 * self.lane);
        self.lanelet(RIGHT, (0.0, length), -half, half);
        if lanes > 1 {
            self.lanelet(LEFT, (0.0, length), half, half + lane);
            self.beside(RIGHT, LEFT);
        }
        self.offsets = (0.0, 0.0);
    }

    fn curve(&mut self, arcs: &[(f64, f64)]) {
        let step = self.scale;
        let mut pose = Pose::new(self.random.within(-1e3, 1e3), self.random.within(-1e3, 1e3), 0.0);
        pose.yaw = self.random.within(-0.5 * TAU, 0.5 * TAU);
        let mut station = 0.0;
        self.line = vec![(station, pose)];
        for &(length, curvature) in arcs {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of metres
            let pieces = (length / step).ceil().max(1.0) as u32;
            let piece = length / f64::from(pieces);
            for _ in 0..pieces {
                // the chord of an arc
                let half = 0.5 * curvature * piece;
                let chord = if half.abs() > 1e-9 { piece * half.sin() / half } else { piece };
                let along = Pose { yaw: pose.yaw + half, ..pose }.advanced(chord);
                pose = Pose { yaw: pose.yaw + 2.0 * half, ..along };
                station += piece;
                self.line.push((station, pose));
            }
        }
    }

    /// The pose at a station and a lateral offset (m), heading along the road.
    fn at(&self, station: f64, offset: f64) -> Pose {
        let after = self.line.partition_point(|(s, _)| *s < station).clamp(1, self.line.len() - 1);
        let ((s0, a), (s1, b)) = (self.line[after - 1], self.line[after]);
        let pose = a.interpolated(&b, (station - s0) / (s1 - s0));
        Pose { position: pose.position + pose.left() * offset, ..pose }
    }

    fn bound(&self, stations: (f64, f64), offset: f64) -> Polyline {
        let inner = self.line.iter().map(|(s, _)| *s).filter(|s| *s > stations.0 + 1e-6 && *s < stations.1 - 1e-6);
        let all = std::iter::once(stations.0).chain(inner).chain([stations.1]);
        let points: Vec<(f64, f64)> = all
            .map(|s| {
                let p = self.at(s, offset).position;
                (p.x, p.y)
            })
            .collect();
        fixtures::line(&points)
    }

    fn lanelet(&mut self, id: LaneletId, stations: (f64, f64), right: f64, left: f64) {
        let (right, left) = (self.bound(stations, right), self.bound(stations, left));
        self.lanelets.push(fixtures::lanelet(id, right, left));
    }

    fn sidewalks(&mut self) {
        let (length, half) = (self.length(), 0.5 * self.lane);
        let width = 2.0 * self.scale;
        self.lanelet(SIDEWALKS, (0.0, length), -half - width, -half);
        self.lanelet(SIDEWALKS + 1, (0.0, length), half, half + width);
        for lanelet in self.lanelets.iter_mut().filter(|l| l.id >= SIDEWALKS) {
            lanelet.types = vec!["sidewalk".into()];
        }
    }

    fn find(&mut self, id: LaneletId) -> Option<&mut Lanelet> {
        self.lanelets.iter_mut().find(|l| l.id == id)
    }

    fn beside(&mut self, right: LaneletId, left: LaneletId) {
        if let Some(lanelet) = self.find(right) {
            lanelet.adjacent_left = Some(Neighbour { id: left, same_direction: true });
        }
        if let Some(lanelet) = self.find(left) {
            lanelet.adjacent_right = Some(Neighbour { id: right, same_direction: true });
        }
    }

    fn follows(&mut self, before: LaneletId, after: LaneletId) {
        if let Some(lanelet) = self.find(before) {
            lanelet.successors.push(after);
        }
        if let Some(lanelet) = self.find(after) {
            lanelet.predecessors.push(before);
        }
    }

    fn add(&mut self, kind: ObstacleKind, shape: Shape, motion: Motion) {
        let id = OBSTACLES + self.obstacles.len() as i64;
        self.obstacles.push(Obstacle { kind, ..fixtures::obstacle(id, shape, motion) });
    }

    /// A static box, its middle `distance` ahead of the front bumper at the start.
    fn fixed(&mut self, distance: f64, offset: f64, length: f64, width: f64) {
        let turned = self.random.within(-0.1, 0.1);
        let pose = self.at(self.start() + self.front() + distance, offset);
        let pose = Pose { yaw: pose.yaw + turned, ..pose };
        self.add(ObstacleKind::ParkedVehicle, Shape::rectangle(length, width), Motion::Static(pose));
    }

    /// A box that moves along the road from a station, at an offset that depends on the time, until the road ends.
    fn moving(&mut self, from: f64, motion: &[(f64, f64)], offset: impl Fn(f64) -> f64, size: (f64, f64)) {
        let states: Vec<TimedPose> = motion
            .iter()
            .enumerate()
            .map(|(k, &(way, speed))| (TIME_STEP * k as f64, from + way, speed))
            .take_while(|(_, station, _)| *station < self.length() - 0.5 * size.0)
            .map(|(time, station, speed)| TimedPose { time, pose: self.at(station, offset(time)), speed })
            .collect();
        if !states.is_empty() {
            self.add(ObstacleKind::Vehicle, Shape::rectangle(size.0, size.1), Motion::Trajectory(states));
        }
    }

    fn finish(mut self, kind: Kind, number: u64) -> Scenario {
        let to_centre = self.vehicle.rear_axle_to_centre;
        // a start a little off the middle of the lane, and not quite along it
        let room = 0.5 * (self.lane - self.vehicle.width);
        let (aside, turned) = (self.random.within(-0.5, 0.5) * room, self.random.within(-0.02, 0.02));
        let start = self.at(self.start(), self.offsets.0 + aside);
        let centre = Pose { yaw: start.yaw + turned, ..start }.advanced(to_centre);
        let goal_length = 8.0 * self.scale;
        let goal_station = self.length() - goal_length - self.front();
        let region = self.at(goal_station, self.offsets.1);
        let part = Part::Rectangle { centre: region, length: goal_length, width: self.lane };
        let speed = self.stops_at_goal.then_some(Interval { min: -0.5, max: 0.5 });
        let goal = Goal {
            position: Some(GoalPosition::Shapes(Shape { parts: vec![part] })),
            time: Interval { min: 0.0, max: DEADLINE },
            speed,
            yaw: None,
        };
        let initial = InitialState { centre, speed: self.speed, acceleration: 0.0, yaw_rate: 0.0, time_step: 0 };
        let mut scenario = fixtures::scenario(fixtures::network(self.lanelets), self.obstacles);
        scenario.id = format!("{}-{number}", kind.name());
        scenario.problems = vec![PlanningProblem { id: 1, initial, goals: vec![goal] }];
        scenario
    }
}

/// Ids: the right lane's lanelets, the left lane's, sidewalks, obstacles.
const RIGHT: LaneletId = 1;
const LEFT: LaneletId = 11;
const SIDEWALKS: LaneletId = 21;
const OBSTACLES: i64 = 101;

fn steps() -> u32 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a constant count
    let steps = (PREDICTED / TIME_STEP) as u32;
    steps
}

/// Distances and speeds at each time step, from a speed and an acceleration that depends on time and speed.
fn speeds(start: f64, acceleration: impl Fn(f64, f64) -> f64) -> Vec<(f64, f64)> {
    let (mut way, mut speed) = (0.0, start);
    let mut all = vec![(way, speed)];
    for k in 0..steps() {
        let next = (speed + acceleration(TIME_STEP * f64::from(k), speed) * TIME_STEP).max(0.0);
        way += f64::midpoint(speed, next) * TIME_STEP;
        speed = next;
        all.push((way, speed));
    }
    all
}

/// The same strip driven the other way.
fn reversed(lanelet: &Lanelet) -> Lanelet {
    let back = |line: &Polyline| {
        let points: Vec<(f64, f64)> = line.points().iter().rev().map(|p| (p.x, p.y)).collect();
        fixtures::line(&points)
    };
    let neighbour = lanelet.adjacent_right.map(|n| Neighbour { same_direction: false, ..n });
    Lanelet { adjacent_left: neighbour, ..fixtures::lanelet(lanelet.id, back(&lanelet.left), back(&lanelet.right)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::vehicle;

    #[test]
    fn a_scene_depends_on_its_seed_and_number_alone() {
        let text = |seed, number| format!("{:?}", Scene::new(seed, number, &vehicle(), 1.0));
        assert_eq!(text(7, 12), text(7, 12));
        assert_ne!(text(7, 12), text(8, 12));
        assert_ne!(text(7, 12), text(7, 12 + Kind::ALL.len() as u64));
    }

    #[test]
    fn every_start_is_within_the_speeds_of_the_tracking_tube() {
        for name in crate::vehicle::builtin_names() {
            let vehicle = crate::vehicle::load(name).unwrap();
            let start = |number| Scene::new(7, number, &vehicle, 1.0).scenario.problems[0].initial.speed;
            let (fastest, limit) = ((0..90).map(start).fold(0.0, f64::max), vehicle.tracking.speed[0]);
            assert!(fastest <= limit && fastest > 0.5 * limit, "{name}: {fastest} {limit}");
        }
    }

    #[test]
    fn every_start_is_on_the_road_and_touches_nothing() {
        let vehicle = vehicle();
        for number in 0..900 {
            let Scene { kind, scenario } = Scene::new(3, number, &vehicle, 1.0);
            let initial = scenario.problems[0].initial;
            assert!((0.0..=TOP_SPEED).contains(&initial.speed));
            let on_road = scenario.network.lanelets.values().any(|l| l.contains(initial.centre.position));
            assert!(on_road, "{kind:?} {number}");
            assert!(!scenario.obstacles.is_empty() || kind == Kind::Bend, "{kind:?} {number}");
        }
    }
}

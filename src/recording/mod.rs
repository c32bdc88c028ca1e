//! Recordings: a run as a `.rrd` file for the Rerun viewer, including the layout.
//!
//! Contents by entity:
//!
//! | entity | content |
//! |---|---|
//! | `map/…` | road surface, bounds, lane markings, stop lines, goal, driven path: logged once |
//! | `map/obstacles/ID` | shape of an obstacle and its pose at each tick; the sets of a set-based prediction |
//! | `map/plan/…` | per planning cycle: reference line, candidates, committed path, footprint at its fallback stop |
//! | `map/ego` | shape of the vehicle and its pose at each tick |
//! | `follow` | frame that moves with the vehicle, for the view that follows it |
//! | `series/…` | speed, acceleration, jerk, lateral acceleration, steering, with references and limits |
//! | `st/…` | station over time of the committed plan, with the blocked cells |
//! | `decisions` | text log: what was committed and why |
//! | `verdict` | text document: the checks, and the failed ones in detail |
//!
//! Positions are in metres from an origin near the start, rounded to whole metres: the viewer computes in `f32`, which
//! would lose centimetres in UTM coordinates. Its 2D views have y down, so `map` is mirrored. They cannot fill polygons
//! either: the road surface is an image, and vehicles are filled with thick strokes (`shapes::hatch`).
//!
//! The recording is built in memory and written under a temporary name, so that a file under the requested name is
//! always complete. Recordings of equal runs have the same recording id but different bytes, since Rerun stamps rows
//! with the wall clock.

mod blueprint;
mod plans;
mod road;
mod series;
mod shapes;
mod style;
mod text;
mod traffic;

use std::path::Path;

use rerun::log::ChunkBatcherConfig;
use rerun::{RecordingStream, RecordingStreamBuilder};
use sha2::{Digest as _, Sha256};

use crate::drive::Run;
use crate::geometry::Point;
use crate::io::files::{WriteError, write_atomic};
use crate::plot::motion::Motion;
use crate::plot::outline::{Bounds, action_bounds};

/// Application id, under which the viewer stores settings for our recordings.
const APPLICATION: &str = "stopline";
/// The timeline, seconds of the run.
const TIMELINE: &str = "time";
/// Time between two poses of the vehicle and the obstacles, s: smooth to the eye.
const TICK: f64 = 0.04;

/// The reason why a recording could not be written. It does not fail the run.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Rerun could not encode the data.
    #[error("Rerun could not encode the recording: {0}")]
    Encoding(Box<dyn std::error::Error + Send + Sync>),
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl RecordingError {
    fn encoding(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Encoding(Box::new(error))
    }
}

/// Writes the recording of a run to `path`, replacing an existing file. For a single planning cycle, whose log is
/// empty, the committed plan replaces the drive.
///
/// # Errors
/// [`RecordingError::Write`] if the file cannot be written, [`RecordingError::Encoding`] if Rerun fails.
pub fn write(run: &Run, path: &Path) -> Result<(), RecordingError> {
    write_atomic(path, &recorded(run)?)?;
    Ok(())
}

/// Common inputs of all parts of the recording.
struct Context<'a> {
    stream: RecordingStream,
    run: &'a Run<'a>,
    motion: Motion,
    /// Bounds of the action, in world coordinates.
    action: Bounds,
    /// World position of the recording's origin.
    origin: Point,
}

impl Context<'_> {
    /// A position relative to the origin; `None` if it is not finite.
    fn local(&self, p: &Point) -> Option<[f32; 2]> {
        #[allow(clippy::cast_possible_truncation)] // near the origin f32 is exact to less than a millimetre
        let local = [(p.x - self.origin.x) as f32, (p.y - self.origin.y) as f32];
        local.iter().all(|c| c.is_finite()).then_some(local)
    }

    /// An open line in local coordinates.
    fn line<'p>(&self, points: impl IntoIterator<Item = &'p Point>) -> Vec<[f32; 2]> {
        points.into_iter().filter_map(|p| self.local(p)).collect()
    }

    /// A closed line in local coordinates.
    fn ring(&self, points: &[Point]) -> Vec<[f32; 2]> {
        self.line(points.iter().chain(points.first()))
    }

    fn set_time(&self, time: f64) {
        self.stream.set_duration_secs(TIMELINE, if time.is_finite() { time } else { 0.0 });
    }

    fn log(&self, entity: &str, data: &impl rerun::AsComponents) -> Result<(), RecordingError> {
        self.stream.log(entity, data).map_err(RecordingError::encoding)
    }

    fn log_static(&self, entity: &str, data: &impl rerun::AsComponents) -> Result<(), RecordingError> {
        self.stream.log_static(entity, data).map_err(RecordingError::encoding)
    }
}

/// The bytes of the recording.
fn recorded(run: &Run) -> Result<Vec<u8>, RecordingError> {
    let id = recording_id(run);
    // `enabled`: no environment variable may disable a requested recording. `NEVER`: everything is flushed at the end.
    let (stream, storage) = RecordingStreamBuilder::new(APPLICATION)
        .enabled(true)
        .recording_id(id.as_str())
        .recording_name(format!("{} · {}", run.scenario.id, run.outcome.name()))
        .batcher_config(ChunkBatcherConfig::NEVER)
        .memory()
        .map_err(RecordingError::encoding)?;
    stream.set_log_tick_enabled(false);
    stream.set_log_time_enabled(false);
    let motion = Motion::of(run);
    let action = action_bounds(run, &motion);
    let origin = start(run, &action).map(f64::floor);
    let context = Context { stream, run, motion, action, origin };
    blueprint::send(&context, &id)?;
    // 2D views have y down: everything under `map` is mirrored
    let mirror = rerun::Transform3D::from_mat3x3([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]);
    context.log_static("map", &mirror)?;
    road::log(&context)?;
    traffic::log(&context)?;
    plans::log(&context)?;
    series::log(&context)?;
    text::log(&context)?;
    context.stream.flush_blocking().map_err(RecordingError::encoding)?;
    storage.drain_as_bytes().map_err(RecordingError::encoding)
}

/// A finite position near the start.
fn start(run: &Run, action: &Bounds) -> Point {
    let start = run.problem.initial.centre.position;
    if start.coords.iter().all(|c| c.is_finite()) { start } else { action.centre() }
}

/// An id derived from the content of the run: the viewer treats two recordings of the same run as one.
fn recording_id(run: &Run) -> String {
    let mut hash = Sha256::new();
    hash.update(run.scenario.id.as_bytes());
    hash.update(run.vehicle.name.as_bytes());
    hash.update(run.problem.id.to_le_bytes());
    hash.update(run.outcome.name().as_bytes());
    for cycle in &run.cycles {
        hash.update(cycle.plan.time.to_le_bytes());
        hash.update(cycle.plan.trajectory.end_time().to_le_bytes());
    }
    for sample in &run.log.samples {
        for number in [sample.time, sample.pose.position.x, sample.pose.position.y, sample.pose.yaw, sample.speed] {
            hash.update(number.to_le_bytes());
        }
    }
    hash.finalize().iter().take(16).map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    use rerun::external::re_log_types::StoreId;
    use rerun::{ChunkStore, ChunkStoreConfig};

    use crate::map::{Motion as ObstacleMotion, RoadNetwork};
    use crate::plot::example::Example;

    /// What Rerun reads from the recording: the store of the run and that of the layout.
    fn read_back(bytes: &[u8]) -> Vec<(StoreId, BTreeSet<String>)> {
        let stores = ChunkStore::from_rrd_reader(&ChunkStoreConfig::DEFAULT, &mut std::io::Cursor::new(bytes)).unwrap();
        let entities = |store: &ChunkStore| store.all_entities_sorted().iter().map(ToString::to_string).collect();
        let mut read: Vec<_> = stores.iter().map(|(id, store)| (id.clone(), entities(store))).collect();
        read.sort_by_key(|(id, _)| id.is_blueprint());
        read
    }

    #[test]
    fn rerun_reads_back_every_part() {
        let example = Example::new();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.rrd");
        write(&example.run(), &path).unwrap();
        let stores = read_back(&std::fs::read(&path).unwrap());
        let [(run, entities), (layout, views)] = stores.as_slice() else { panic!("two stores: {stores:?}") };
        assert!(run.is_recording() && layout.is_blueprint());
        let parts = ["map", "map/surface", "map/bounds", "map/lane_marks", "map/stop_lines", "map/goal", "map/driven"];
        let plans = [
            "map/plan/committed",
            "map/plan/fallback_stop",
            "map/plan/candidates/reasons",
            "map/plan/candidates/costs",
            "st/plan",
            "st/blocked",
        ];
        let series = ["speed", "acceleration", "jerk", "lateral_acceleration", "steering"];
        let text = ["decisions", "verdict", "map/ego", "map/ego/fill", "follow"];
        let obstacles = example.scenario.obstacles.iter().map(|o| format!("map/obstacles/{}", o.id));
        let expected = parts.into_iter().chain(plans).chain(text).map(str::to_owned).chain(obstacles);
        for entity in expected.chain(series.map(|name| format!("series/{name}/driven"))) {
            assert!(entities.contains(&format!("/{entity}")), "{entity} is missing in {entities:?}");
        }
        let count = |property: &str| views.iter().filter(|v| v.ends_with(property)).count();
        assert_eq!((count("/VisualBounds2D"), count("/ScalarAxis"), count("/TimeAxis")), (3, 5, 5), "{views:?}");
    }

    #[test]
    fn equal_runs_have_equal_recording_ids() {
        let example = Example::new();
        let id = |run: &Run| read_back(&recorded(run).unwrap())[0].0.clone();
        assert_eq!(id(&example.run()), id(&example.run()));
        let mut other = example.run();
        other.log.samples[7].speed += 1e-9;
        assert_ne!(id(&example.run()), id(&other));
    }

    #[test]
    fn positions_are_relative_to_the_start_and_invalid_ones_are_dropped() {
        let example = Example::new();
        let run = example.run();
        let (stream, _storage) = RecordingStreamBuilder::new(APPLICATION).memory().unwrap();
        let motion = Motion::of(&run);
        let action = action_bounds(&run, &motion);
        let origin = start(&run, &action).map(f64::floor);
        let context = Context { stream, run: &run, motion, action, origin };
        let start = run.problem.initial.centre.position;
        let close = context.local(&(start + nalgebra::Vector2::new(0.001, 0.25))).unwrap();
        let exact = [start.x + 0.001 - origin.x, start.y + 0.25 - origin.y];
        assert!(close.iter().zip(exact).all(|(c, e)| (f64::from(*c) - e).abs() < 1e-6), "{close:?} for {exact:?}");
        let points = [start, Point::new(f64::NAN, 0.0), Point::new(0.0, f64::INFINITY)];
        assert_eq!(context.line(&points).len(), 1);
    }

    #[test]
    fn the_error_names_a_path_that_cannot_be_written() {
        let example = Example::new();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no such folder").join("run.rrd");
        let error = write(&example.run(), &path).unwrap_err();
        assert!(matches!(error, RecordingError::Write(_)));
        assert!(error.to_string().contains("no such folder"), "{error}");
    }

    #[test]
    fn records_a_single_cycle_and_an_empty_run() {
        let mut example = Example::new();
        let mut run = example.run();
        run.cycles.truncate(1);
        run.log.samples.clear();
        run.verdict.checks.clear();
        let entities = read_back(&recorded(&run).unwrap())[0].1.clone();
        assert!(entities.contains("/map/ego") && entities.contains("/series/speed/driven"));
        example.scenario.network = RoadNetwork::default();
        example.scenario.obstacles.clear();
        let mut run = example.run();
        run.cycles.clear();
        run.log.samples.clear();
        assert!(!recorded(&run).unwrap().is_empty());
    }

    #[test]
    fn records_a_run_with_invalid_numbers() {
        let mut example = Example::new();
        example.scenario.problems[0].initial.centre.position.x = f64::NAN;
        for obstacle in &mut example.scenario.obstacles {
            if let ObstacleMotion::Static(pose) = &mut obstacle.motion {
                pose.yaw = f64::NAN;
            }
        }
        let mut run = example.run();
        run.log.samples[5].acceleration = f64::NAN;
        run.cycles[3].plan.time = f64::NAN;
        run.cycles[4].trace.blocked.push(crate::planner::BlockedCell {
            stations: (f64::NAN, 3.0),
            times: (0.0, f64::INFINITY),
            obstacle: 1,
        });
        assert!(!recorded(&run).unwrap().is_empty());
    }
}

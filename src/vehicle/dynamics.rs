//! Reads `dynamics.toml`: tyres, actuators, limits, comfort and, if measured, tracking errors. Every key is required except
//! the table `tracking`; an unknown key is an error.

use std::path::Path;

use serde::Deserialize;

use super::{Actuators, Comfort, Limits, TrackingTube, Tyres, VehicleError};
use crate::io::settings_file::with_suggestion;
use crate::number;

/// Content of the file, checked.
#[derive(Debug)]
pub(super) struct Dynamics {
    pub(super) commonroad_type: Option<u8>,
    limits: LimitsTable,
    pub(super) tyres: Tyres,
    pub(super) actuators: Actuators,
    pub(super) comfort: Comfort,
    pub(super) tracking: Option<TrackingTube>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    commonroad_type: Option<u8>,
    limits: LimitsTable,
    #[serde(with = "TyresTable")]
    tyres: Tyres,
    #[serde(with = "ActuatorsTable")]
    actuators: Actuators,
    #[serde(with = "ComfortTable")]
    comfort: Comfort,
    tracking: Option<TrackingTable>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsTable {
    steering_acceleration: f64,
    speed: f64,
    acceleration: f64,
    switching_speed: f64,
    deceleration: f64,
}

#[derive(Deserialize)]
#[serde(remote = "Tyres", deny_unknown_fields)]
struct TyresTable {
    friction: f64,
    cornering_front: f64,
    cornering_rear: f64,
    longitudinal: f64,
    relaxation_length: f64,
    rolling_resistance: f64,
    drag: f64,
}

#[derive(Deserialize)]
#[serde(remote = "Actuators", deny_unknown_fields)]
struct ActuatorsTable {
    drive_lag: f64,
    brake_lag: f64,
    steering_lag: f64,
    drive_front_share: f64,
    brake_front_share: f64,
}

#[derive(Deserialize)]
#[serde(remote = "Comfort", deny_unknown_fields)]
struct ComfortTable {
    acceleration: f64,
    deceleration: f64,
    aggressive_deceleration: f64,
    lateral_acceleration: f64,
    jerk: f64,
}

/// Lists of any length: serde leaves out what an array has too much.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrackingTable {
    speed: Vec<f64>,
    lateral: Vec<f64>,
    longitudinal: Vec<f64>,
    heading: Vec<f64>,
}

impl Dynamics {
    /// The limits, with those of the steering joints.
    pub(super) fn limits(&self, steering: f64, steering_rate: f64) -> Limits {
        let LimitsTable { steering_acceleration, speed, acceleration, switching_speed, deceleration } = self.limits;
        Limits { steering, steering_rate, steering_acceleration, speed, acceleration, switching_speed, deceleration }
    }
}

/// Reads and checks the file's text.
pub(super) fn read(file: &Path, text: &str) -> Result<Dynamics, VehicleError> {
    let File { commonroad_type, limits, tyres, actuators, comfort, tracking } =
        toml::from_str(text).map_err(|e| VehicleError::Toml { file: file.to_owned(), message: with_suggestion(&e) })?;
    let check = |element: &str, value: f64, ok: bool, expected| {
        if ok && value.is_finite() {
            return Ok(());
        }
        Err(VehicleError::Element {
            file: file.to_owned(),
            element: element.into(),
            found: number::exact(value),
            expected,
        })
    };
    // far beyond trucks of 60 t, racing cars and model cars: a larger number is a typing error, and the simulation diverges
    for (element, value, most, expected) in [
        ("limits.steering_acceleration", limits.steering_acceleration, 1000.0, "above 0, at most 1000 rad/s²"),
        ("limits.speed", limits.speed, 150.0, "above 0, at most 150 m/s"),
        ("limits.acceleration", limits.acceleration, 100.0, "above 0, at most 100 m/s²"),
        ("limits.switching_speed", limits.switching_speed, 1000.0, "above 0, at most 1000 m/s"),
        ("limits.deceleration", limits.deceleration, 100.0, "above 0, at most 100 m/s²"),
        ("tyres.friction", tyres.friction, 5.0, "above 0, at most 5"),
        ("tyres.cornering_front", tyres.cornering_front, 200.0, "above 0, at most 200 1/rad per unit of load"),
        ("tyres.cornering_rear", tyres.cornering_rear, 200.0, "above 0, at most 200 1/rad per unit of load"),
        ("tyres.longitudinal", tyres.longitudinal, 200.0, "above 0, at most 200 per unit of load"),
        ("tyres.relaxation_length", tyres.relaxation_length, 10.0, "above 0, at most 10 m"),
        ("actuators.drive_lag", actuators.drive_lag, 10.0, "above 0, at most 10 s"),
        ("actuators.brake_lag", actuators.brake_lag, 10.0, "above 0, at most 10 s"),
        ("actuators.steering_lag", actuators.steering_lag, 10.0, "above 0, at most 10 s"),
        ("comfort.acceleration", comfort.acceleration, 100.0, "above 0, at most 100 m/s²"),
        ("comfort.deceleration", comfort.deceleration, 100.0, "above 0, at most 100 m/s²"),
        ("comfort.lateral_acceleration", comfort.lateral_acceleration, 100.0, "above 0, at most 100 m/s²"),
        ("comfort.jerk", comfort.jerk, 1000.0, "above 0, at most 1000 m/s³"),
    ] {
        check(element, value, value > 0.0 && value <= most, expected)?;
    }
    for (element, value, most, expected) in [
        ("tyres.rolling_resistance", tyres.rolling_resistance, 1.0, "from 0 to 1"),
        ("tyres.drag", tyres.drag, 100.0, "from 0 to 100 N s²/m²"),
        ("actuators.drive_front_share", actuators.drive_front_share, 1.0, "a share from 0 to 1"),
        ("actuators.brake_front_share", actuators.brake_front_share, 1.0, "a share from 0 to 1"),
    ] {
        check(element, value, (0.0..=most).contains(&value), expected)?;
    }
    let aggressive = comfort.aggressive_deceleration;
    check(
        "comfort.aggressive_deceleration",
        aggressive,
        aggressive >= comfort.deceleration && aggressive <= 100.0,
        "at least comfort.deceleration, at most 100 m/s²",
    )?;
    let tracking = tracking.map(|table| tube(file, &table)).transpose()?;
    Ok(Dynamics { commonroad_type, limits, tyres, actuators, comfort, tracking })
}

/// Checks the table `tracking`.
fn tube(file: &Path, table: &TrackingTable) -> Result<TrackingTube, VehicleError> {
    let speeds = |v: &[f64; 3]| v[0] >= v[1] && v[1] >= v[2] && v[2] > 0.0;
    let bounds = |v: &[f64; 2]| v[0] >= 0.0 && v[1] >= 0.0;
    let bound = |element, list| numbers(file, element, list, bounds, "two finite numbers of at least 0");
    let expected = "three positive finite numbers, none larger than the one before";
    Ok(TrackingTube {
        speed: numbers(file, "tracking.speed", &table.speed, speeds, expected)?,
        lateral: bound("tracking.lateral", &table.lateral)?,
        longitudinal: bound("tracking.longitudinal", &table.longitudinal)?,
        heading: bound("tracking.heading", &table.heading)?,
    })
}

/// A list of as many finite numbers as fit.
fn numbers<const N: usize>(
    file: &Path,
    element: &str,
    list: &[f64],
    fits: impl Fn(&[f64; N]) -> bool,
    expected: &'static str,
) -> Result<[f64; N], VehicleError> {
    let checked = <[f64; N]>::try_from(list).ok().filter(|v| v.iter().all(|x| x.is_finite()) && fits(v));
    checked.ok_or_else(|| {
        let found: Vec<String> = list.iter().map(|x| number::exact(*x)).collect();
        let (file, element, found) = (file.to_owned(), element.into(), format!("[{}]", found.join(", ")));
        VehicleError::Element { file, element, found, expected }
    })
}

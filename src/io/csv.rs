//! Writes the log of a run as CSV: one row for each sample, one column for each quantity, with units in the header.
//!
//! The cells are numbers, so no cell needs quotes.

use crate::simulation::{Log, Sample};

/// A column: its name with the unit, and its value for a sample.
type Column = (&'static str, fn(&Sample) -> f64);

/// The columns in order. Poses are those of the rear axle's centre.
const COLUMNS: [Column; 19] = [
    ("time_s", |s| s.time),
    ("x_m", |s| s.pose.position.x),
    ("y_m", |s| s.pose.position.y),
    ("yaw_rad", |s| s.pose.yaw),
    ("speed_mps", |s| s.speed),
    ("lateral_speed_mps", |s| s.lateral_speed),
    ("yaw_rate_radps", |s| s.yaw_rate),
    ("acceleration_mps2", |s| s.acceleration),
    ("lateral_acceleration_mps2", |s| s.lateral_acceleration),
    ("steering_rad", |s| s.steering),
    ("commanded_acceleration_mps2", |s| s.commanded_acceleration),
    ("commanded_steering_rad", |s| s.commanded_steering),
    ("reference_x_m", |s| s.reference_pose.position.x),
    ("reference_y_m", |s| s.reference_pose.position.y),
    ("reference_yaw_rad", |s| s.reference_pose.yaw),
    ("reference_speed_mps", |s| s.reference_speed),
    ("reference_station_m", |s| s.reference_station),
    ("position_error_m", |s| (s.pose.position - s.reference_pose.position).norm()),
    ("speed_error_mps", |s| s.speed - s.reference_speed),
];

/// The log as CSV. Each number has the digits that identify its `f64`; the cell of a number that is not finite is empty.
#[must_use]
pub fn log_to_csv(log: &Log) -> String {
    let mut text = COLUMNS.map(|(name, _)| name).join(",");
    text.push('\n');
    for sample in &log.samples {
        let cell = |(_, value): Column| {
            Some(value(sample)).filter(|v| v.is_finite()).map_or_else(String::new, |v| v.to_string())
        };
        text.push_str(&COLUMNS.map(cell).join(","));
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    #[test]
    fn numbers_round_trip_and_non_finite_ones_are_empty() {
        let pose = Pose::new(1.0e6 / 3.0, -2.5, 0.1);
        let sample = Sample {
            time: 0.1 + 0.2,
            pose,
            speed: 8.0,
            lateral_speed: -1e-17,
            yaw_rate: f64::NAN,
            acceleration: 0.0,
            lateral_acceleration: f64::INFINITY,
            steering: 0.0,
            commanded_acceleration: 0.0,
            commanded_steering: 0.0,
            reference_pose: pose.advanced(2.0),
            reference_speed: 9.0,
            reference_station: 0.0,
        };
        let text = log_to_csv(&Log { samples: vec![sample; 2], ..Log::default() });
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let headers = reader.headers().unwrap().clone();
        let rows: Vec<_> = reader.records().map(|r| r.unwrap()).collect();
        assert_eq!(rows.len(), 2);
        let cell = |name: &str| rows[0][headers.iter().position(|h| h == name).unwrap()].to_owned();
        assert_eq!(cell("time_s").parse::<f64>().unwrap(), 0.1 + 0.2);
        assert_eq!(cell("x_m").parse::<f64>().unwrap(), 1.0e6 / 3.0);
        assert_eq!(cell("lateral_speed_mps").parse::<f64>().unwrap(), -1e-17);
        assert_eq!((cell("yaw_rate_radps"), cell("lateral_acceleration_mps2")), (String::new(), String::new()));
        assert!((cell("position_error_m").parse::<f64>().unwrap() - 2.0).abs() < 1e-9);
        assert_eq!(cell("speed_error_mps"), "-1");
    }
}

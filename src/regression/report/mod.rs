//! Reports of suites: JSON, JUnit XML, Markdown, HTML.
//!
//! The same drives give the same bytes, whatever the number of jobs and however long it took: nothing here reads a
//! clock. Text from files (ids, notes, messages) is escaped as each format asks for.

mod html;
mod json;
mod junit;
mod markdown;

pub use html::html;
pub use json::{FORMAT, json};
pub use junit::junit;
pub use markdown::markdown;

/// Figures shown of every drive, with a heading and a unit; the JSON has all.
const SHOWN: [(&str, &str); 6] = [
    ("duration_s", "duration, s"),
    ("mean_speed_mps", "mean speed, m/s"),
    ("min_clearance_m", "clearance, m"),
    ("max_abs_acceleration_mps2", "acceleration, m/s²"),
    ("max_abs_lateral_acceleration_mps2", "lateral, m/s²"),
    ("stop_error_m", "stop error, m"),
];

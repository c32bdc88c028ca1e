//! Reports of suites: JSON, JUnit XML, Markdown, HTML.
//!
//! Equal results give equal bytes, for every number of jobs: no report contains wall-clock times. Each report escapes
//! text from files (ids, notes, messages) for its format.

mod html;
mod json;
mod junit;
mod markdown;

pub use html::html;
pub use json::{FORMAT, json};
pub use junit::junit;
pub use markdown::markdown;

/// The metrics in the table of all drives, with heading and unit; the JSON contains all metrics.
const COLUMNS: [(&str, &str); 6] = [
    ("duration_s", "duration, s"),
    ("mean_speed_mps", "mean speed, m/s"),
    ("min_clearance_m", "clearance, m"),
    ("max_abs_acceleration_mps2", "acceleration, m/s²"),
    ("max_abs_lateral_acceleration_mps2", "lateral, m/s²"),
    ("stop_error_m", "stop error, m"),
];

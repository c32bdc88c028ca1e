//! Reading `vehicles/NAME/`: `vehicle.urdf` and `dynamics.toml`.

use std::path::Path;

use super::Vehicle;

/// Why a vehicle could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct VehicleError(String);

/// Names of the vehicles built into the program.
#[must_use]
pub fn builtin_names() -> &'static [&'static str] {
    &["bmw_320i", "ford_escort"]
}

/// Loads a vehicle by built-in name, or from a folder that holds `vehicle.urdf` and `dynamics.toml`.
///
/// # Errors
/// An unknown name, an unreadable file, or a value out of its range.
pub fn load(name_or_folder: &str) -> Result<Vehicle, VehicleError> {
    let _ = Path::new(name_or_folder);
    Err(VehicleError("not there yet".into()))
}

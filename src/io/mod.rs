//! Files: one module per format, into and out of [`crate::map`].
//!
//! A reader gives the usable map **and** the list of problems it met; only what cannot be read safely is an error, and
//! the error names the file, the line and the element. Writers never leave half a file behind: [`files`].

pub mod commonroad;
pub mod csv;
pub mod files;
pub mod kind;
pub mod ros_map;
pub mod settings_file;
pub mod solution;

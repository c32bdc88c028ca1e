//! Readers and writers of files, one module per format, from and to the types of [`crate::map`].
//!
//! A reader returns the usable map **and** the list of issues. Only content that cannot be read safely is an error; the
//! error names the file, the line, the element and the expected value. [`text`] decodes and decompresses for all text
//! formats; [`files`] writes atomically.

pub mod commonroad;
pub mod csv;
pub mod files;
pub mod kind;
mod renamed_keys;
#[cfg(feature = "images")]
pub mod ros_map;
pub mod settings_file;
pub mod solution;
pub mod text;

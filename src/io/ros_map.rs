//! Reader of the occupancy grids of ROS: a YAML file that names an image (`map_server`, `nav2_map_server`).
//!
//! Format: <https://wiki.ros.org/map_server#Map_format>. `image` (a path relative to the YAML file, or absolute),
//! `resolution` (m), `origin` [x, y, yaw] of the lower left corner of the image, `negate`, `occupied_thresh`,
//! `free_thresh` and `mode`:
//!
//! - `trinary` (the default): p = (255 − grey)/255, or grey/255 if `negate` is set. A cell is occupied above
//!   `occupied_thresh`, free below `free_thresh`, and unknown between.
//! - `scale`: the same, but a pixel that is not opaque is unknown. In ROS, values between the thresholds are
//!   probabilities; here they are unknown.
//! - `raw`: the grey value is the occupancy in percent; above 100 unknown.
//!
//! Grey is the mean of red, green and blue. The first row of the image has the largest y, that of the grid the smallest.
//!
//! Every invalid value in the YAML file is an error, with its line: a shifted or inverted map would be dangerous. The
//! image is a PNG, PGM, PPM or PBM file, text or binary. Its header is checked against [`MAX_CELLS`] before its pixels are
//! allocated.
//!
//! Limits: 16-bit images are reduced to 8 bits, for which the thresholds of the format are meant.

use std::path::{Path, PathBuf};

use image::{GenericImageView as _, ImageReader, Limits};
use serde_saphyr::Spanned;

use super::files::{self, InputError};
use super::text;
use crate::geometry::Pose;
use crate::map::{Cell, OccupancyGrid};

/// Most cells of a grid: 8192 × 8192.
pub const MAX_CELLS: u64 = 1 << 26;
/// Largest YAML file, bytes.
const MAX_YAML: u64 = 1 << 20;
/// Largest image file and largest decoded image, bytes.
const MAX_IMAGE: u64 = 256 << 20;

/// Why a grid could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The YAML file cannot be read, or is not text.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Not YAML, or a required key is missing.
    #[error("{file}:{line}: not a map of ROS: {message}")]
    NotAMap {
        /// The file.
        file: String,
        /// Line, 1-based; 0 if the error concerns the file as a whole.
        line: u64,
        /// The parser's reason.
        message: String,
    },
    /// A value of the wrong type or out of its range.
    #[error("{file}:{line}: {element} is {found}, expected {expected}")]
    BadValue {
        /// The YAML file.
        file: String,
        /// Line, 1-based.
        line: u64,
        /// The key.
        element: &'static str,
        /// The value.
        found: String,
        /// The values that are valid.
        expected: &'static str,
    },
    /// The image is missing, or not a valid image.
    #[error("{file}:{line}: image \"{image}\": {message}")]
    Image {
        /// The YAML file.
        file: String,
        /// Line of the key `image`.
        line: u64,
        /// Path of the image in the YAML file.
        image: String,
        /// The reason.
        message: String,
    },
}

/// Content of the YAML file. Other keys are ignored.
#[derive(Debug, serde::Deserialize)]
struct Header {
    image: Spanned<String>,
    resolution: Spanned<f64>,
    origin: Spanned<Vec<f64>>,
    negate: Spanned<Flag>,
    occupied_thresh: Spanned<f64>,
    free_thresh: Spanned<f64>,
    mode: Option<Spanned<String>>,
}

/// ROS writes 0 and 1; true and false are accepted, too.
#[derive(Debug, serde::Deserialize)]
#[serde(untagged)]
enum Flag {
    Bool(bool),
    Number(f64),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Trinary,
    Scale,
    Raw,
}

/// The rule that maps a grey value to a cell.
struct Classifier {
    mode: Mode,
    negate: bool,
    occupied_above: f64,
    free_below: f64,
}

impl Classifier {
    fn cell(&self, [r, g, b, alpha]: [u8; 4]) -> Cell {
        let grey = (f64::from(r) + f64::from(g) + f64::from(b)) / (3.0 * 255.0);
        let occupancy = match self.mode {
            Mode::Scale if alpha < u8::MAX => return Cell::Unknown,
            Mode::Trinary | Mode::Scale => {
                if self.negate {
                    grey
                } else {
                    1.0 - grey
                }
            }
            Mode::Raw => {
                let percent = (255.0 * if self.negate { 1.0 - grey } else { grey }).round();
                if percent > 100.0 {
                    return Cell::Unknown;
                }
                percent / 100.0
            }
        };
        if occupancy > self.occupied_above {
            Cell::Occupied
        } else if occupancy < self.free_below {
            Cell::Free
        } else {
            Cell::Unknown
        }
    }
}

/// Reads a grid from a YAML file and its image.
///
/// # Errors
/// A file cannot be read, or has a missing or invalid value.
pub fn read_file(path: &Path) -> Result<OccupancyGrid, ReadError> {
    let yaml = text::read(path, MAX_YAML)?;
    read(&path.display().to_string(), &yaml, |image| files::read(&beside(path, image), MAX_IMAGE))
}

/// Path of the image of a YAML file; `None` if the file is invalid.
#[must_use]
pub fn image_of(path: &Path) -> Option<PathBuf> {
    let header: Header = serde_saphyr::from_str(&text::read(path, MAX_YAML).ok()?).ok()?;
    Some(beside(path, &header.image.value))
}

/// Path of a file that the YAML file names: relative to its folder, or absolute.
fn beside(yaml: &Path, image: &str) -> PathBuf {
    yaml.parent().unwrap_or(Path::new("")).join(image)
}

/// Reads a grid from the text of a YAML file. `name` stands for the file in messages; `open` returns the bytes of the
/// image.
///
/// # Errors
/// As [`read_file`].
pub fn read<E: std::fmt::Display>(
    name: &str,
    yaml: &str,
    open: impl FnOnce(&str) -> Result<Vec<u8>, E>,
) -> Result<OccupancyGrid, ReadError> {
    let file = name.to_owned();
    let mut options = serde_saphyr::Options::default();
    options.with_snippet = false;
    let header: Header = serde_saphyr::from_str_with_options(yaml, options).map_err(|e| ReadError::NotAMap {
        file: file.clone(),
        line: e.location().map_or(0, |l| l.line()),
        message: e.to_string(),
    })?;
    let (pose, resolution, classifier) = (header.origin(name)?, header.resolution(name)?, header.classifier(name)?);
    let image_error = |message: String| ReadError::Image {
        file: file.clone(),
        line: header.image.defined.line(),
        image: header.image.value.clone(),
        message,
    };
    let bytes = open(&header.image.value).map_err(|e| image_error(e.to_string()))?;
    let (width, height, cells) = cells(&bytes, &classifier).map_err(image_error)?;
    OccupancyGrid::new(pose, resolution, width, height, cells).map_err(|e| image_error(e.to_string()))
}

/// Largest side of a cell, m.
const LARGEST_CELL: f64 = 1e3;
/// Largest coordinate, m, as in the scenario reader.
const LARGEST_COORDINATE: f64 = 1e9;

impl Header {
    fn origin(&self, file: &str) -> Result<Pose, ReadError> {
        let is_valid = |v: &f64| v.abs() <= LARGEST_COORDINATE;
        match self.origin.value[..] {
            [x, y, yaw] if self.origin.value.iter().all(is_valid) => Ok(Pose::new(x, y, yaw)),
            _ => {
                Err(bad(file, &self.origin, "origin", format!("{:?}", self.origin.value), "[x, y, yaw], at most 1e9 m"))
            }
        }
    }

    fn resolution(&self, file: &str) -> Result<f64, ReadError> {
        let value = self.resolution.value;
        let is_valid = value > 0.0 && value <= LARGEST_CELL;
        let expected = "a positive number of metres, at most 1000";
        let wrong = || bad(file, &self.resolution, "resolution", format!("{value:?}"), expected);
        is_valid.then_some(value).ok_or_else(wrong)
    }

    fn classifier(&self, file: &str) -> Result<Classifier, ReadError> {
        for (key, threshold) in [("occupied_thresh", &self.occupied_thresh), ("free_thresh", &self.free_thresh)] {
            if !(0.0..=1.0).contains(&threshold.value) {
                return Err(bad(file, threshold, key, threshold.value.to_string(), "a number from 0 to 1"));
            }
        }
        if self.free_thresh.value > self.occupied_thresh.value {
            let found = self.free_thresh.value.to_string();
            return Err(bad(file, &self.free_thresh, "free_thresh", found, "at most occupied_thresh"));
        }
        let mode = match self.mode.as_ref().map(|m| (m, m.value.as_str())) {
            None | Some((_, "trinary")) => Mode::Trinary,
            Some((_, "scale")) => Mode::Scale,
            Some((_, "raw")) => Mode::Raw,
            Some((mode, found)) => return Err(bad(file, mode, "mode", found.to_owned(), "trinary, scale or raw")),
        };
        let negate = match self.negate.value {
            Flag::Bool(value) => value,
            Flag::Number(0.0) => false,
            Flag::Number(1.0) => true,
            Flag::Number(found) => return Err(bad(file, &self.negate, "negate", found.to_string(), "0 or 1")),
        };
        Ok(Classifier { mode, negate, occupied_above: self.occupied_thresh.value, free_below: self.free_thresh.value })
    }
}

fn bad<T>(file: &str, at: &Spanned<T>, element: &'static str, found: String, expected: &'static str) -> ReadError {
    ReadError::BadValue { file: file.to_owned(), line: at.defined.line(), element, found, expected }
}

/// Width, height and cells of an image, from the lowest row.
fn cells(bytes: &[u8], classifier: &Classifier) -> Result<(usize, usize, Vec<Cell>), String> {
    let invalid = |e: &dyn std::fmt::Display| {
        format!("not a complete image ({} bytes): {e}; expected a PNG, PGM, PPM or PBM file", bytes.len())
    };
    let reader = || {
        let mut reader =
            ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format().map_err(|e| invalid(&e))?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(MAX_IMAGE);
        reader.limits(limits);
        Ok::<_, String>(reader)
    };
    // before the pixels are allocated
    let (width, height) = reader()?.into_dimensions().map_err(|e| invalid(&e))?;
    if u64::from(width) * u64::from(height) > MAX_CELLS {
        return Err(format!("{width} × {height} pixels, expected at most {MAX_CELLS} in total"));
    }
    let image = reader()?.decode().map_err(|e| invalid(&e))?;
    let mut cells = Vec::with_capacity(width as usize * height as usize);
    for row in (0..image.height()).rev() {
        cells.extend((0..image.width()).map(|column| classifier.cell(image.get_pixel(column, row).0)));
    }
    Ok((image.width() as usize, image.height() as usize, cells))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use proptest::prelude::*;

    const YAML: &str = "image: map.pgm\nresolution: 0.5\norigin: [1.0, -2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
    /// Two rows of three pixels: black, grey, white; below, white, white, black.
    const PGM: &[u8] = b"P5\n# CREATOR: a test\n3 2\n255\n\x00\x80\xff\xff\xff\x00";

    fn read_with(yaml: &str, image: &[u8]) -> Result<OccupancyGrid, ReadError> {
        read("map.yaml", yaml, |_| Ok::<_, InputError>(image.to_vec()))
    }

    fn rows(grid: &OccupancyGrid) -> Vec<String> {
        let letter = |c| match c {
            Some(Cell::Occupied) => '#',
            Some(Cell::Free) => '.',
            Some(Cell::Unknown) => '?',
            None => ' ',
        };
        (0..grid.height()).map(|r| (0..grid.width()).map(|c| letter(grid.cell(c, r))).collect()).collect()
    }

    #[test]
    fn the_first_row_of_the_image_has_the_largest_y() {
        let grid = read_with(YAML, PGM).unwrap();
        assert_eq!(rows(&grid), ["..#", "#?."]);
        assert_eq!(grid.cell_at(Point::new(2.4, -1.9)), Some(Cell::Occupied));
        assert_eq!(grid.cell_at(Point::new(1.1, -1.1)), Some(Cell::Occupied));
    }

    #[test]
    fn reads_text_images_and_rotated_origins() {
        let text = b"P2\n3 2\n255\n0 128 255\n255 255 0\n";
        let yaml = YAML.replace("0.0]", "1.5707963267948966]");
        let grid = read_with(&yaml, text).unwrap();
        assert_eq!(rows(&grid), ["..#", "#?."]);
        // the third column of the lowest row is above the origin
        assert_eq!(grid.cell_at(Point::new(0.9, -0.9)), Some(Cell::Occupied));
    }

    #[test]
    fn modes_and_negation_are_those_of_ros() {
        let negated = read_with(&YAML.replace("negate: 0", "negate: true"), PGM).unwrap();
        assert_eq!(rows(&negated), ["##.", ".?#"]);
        // raw: 128 and 255 are above 100 %, so unknown; 70 % is occupied
        let raw = YAML.to_owned() + "mode: raw\n";
        let image = b"P5\n3 2\n255\n\x00\x80\xff\x46\x28\x05";
        assert_eq!(rows(&read_with(&raw, image).unwrap()), ["#?.", ".??"]);
        let scale = YAML.to_owned() + "mode: scale\n";
        assert_eq!(rows(&read_with(&scale, PGM).unwrap()), ["..#", "#?."]);
        let mut png = std::io::Cursor::new(Vec::new());
        let image = image::GrayAlphaImage::from_raw(3, 1, vec![0, 255, 0, 254, 255, 255]).unwrap();
        image.write_to(&mut png, image::ImageFormat::Png).unwrap();
        assert_eq!(rows(&read_with(&scale, png.get_ref()).unwrap()), ["#?."]);
        assert_eq!(rows(&read_with(YAML, png.get_ref()).unwrap()), ["##."]);
    }

    #[test]
    fn names_the_line_of_an_invalid_value() {
        let cases = [
            ("0.5", "0", "map.yaml:2: resolution is 0.0, expected a positive number of metres, at most 1000"),
            ("0.5", ".nan", "map.yaml:2: resolution is NaN, expected a positive number of metres, at most 1000"),
            ("[1.0, -2.0, 0.0]", "[1.0, 2.0]", "map.yaml:3: origin is [1.0, 2.0], expected [x, y, yaw], at most 1e9 m"),
            ("-2.0", ".inf", "map.yaml:3: origin is [1.0, inf, 0.0], expected [x, y, yaw], at most 1e9 m"),
            ("negate: 0", "negate: 2", "map.yaml:4: negate is 2, expected 0 or 1"),
            ("0.65", "1.5", "map.yaml:5: occupied_thresh is 1.5, expected a number from 0 to 1"),
            ("0.196", "0.9", "map.yaml:6: free_thresh is 0.9, expected at most occupied_thresh"),
        ];
        for (from, to, message) in cases {
            assert_eq!(read_with(&YAML.replace(from, to), PGM).unwrap_err().to_string(), message);
        }
        for (valid, invalid, element) in [("0.5", "1e50", "resolution"), ("-2.0", "1e50", "origin")] {
            let error = read_with(&YAML.replacen(valid, invalid, 1), PGM).unwrap_err().to_string();
            assert!(error.contains(element) && error.contains("at most"), "{error}");
        }
        let error = read_with(&(YAML.to_owned() + "mode: quaternary\n"), PGM).unwrap_err();
        assert_eq!(error.to_string(), "map.yaml:7: mode is quaternary, expected trinary, scale or raw");
        for missing in ["image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"] {
            let yaml: String = YAML.lines().filter(|l| !l.starts_with(missing)).map(|l| l.to_owned() + "\n").collect();
            let error = read_with(&yaml, PGM).unwrap_err().to_string();
            assert!(error.contains("not a map of ROS") && error.contains(missing), "{error}");
        }
        assert!(matches!(read_with("image: [", PGM), Err(ReadError::NotAMap { line: 1.., .. })));
    }

    #[test]
    fn names_the_line_of_a_missing_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.yaml");
        std::fs::write(&path, YAML).unwrap();
        let error = read_file(&path).unwrap_err().to_string();
        let image = folder.path().join("map.pgm");
        let expected = format!("map.yaml:1: image \"map.pgm\": {}: cannot be read: ", image.display());
        assert!(error.contains(&expected), "{error}");
        std::fs::write(folder.path().join("map.pgm"), PGM).unwrap();
        assert_eq!(rows(&read_file(&path).unwrap()), ["..#", "#?."]);
        assert!(matches!(read_file(&folder.path().join("none.yaml")), Err(ReadError::Input(_))));
    }

    #[test]
    fn refuses_an_image_header_of_gigabytes() {
        for header in [
            "P5 65000 65000 255\n",
            "P5 4294967295 4294967295 255\n",
            "P6 8192 8192 65535\n",
            "P2 20000 3000 255\n1 2 3",
        ] {
            let error = read_with(YAML, header.as_bytes()).unwrap_err();
            assert!(matches!(error, ReadError::Image { line: 1, .. }), "{header}: {error}");
        }
        for invalid in [&b""[..], b"P5", b"GIF89a", b"P5 0 0 255\n"] {
            let error = read_with(YAML, invalid).unwrap_err().to_string();
            let named = error.starts_with("map.yaml:1: image \"map.pgm\": ") && error.contains("expected ");
            assert!(named, "{invalid:?}: {error}");
        }
    }

    proptest! {
        /// Random changes give a grid or an error.
        #[test]
        fn mutated_files_never_panic(
            at in prop::collection::vec((0..200usize, any::<u8>()), 1..6), cut in 0..200usize, in_image in any::<bool>(), text in any::<bool>(),
        ) {
            let mut yaml = (YAML.to_owned() + "mode: scale\n").into_bytes();
            let mut image = if text { b"P2\n3 2\n255\n0 128 255\n255 255 0\n".to_vec() } else { PGM.to_vec() };
            let bytes = if in_image { &mut image } else { &mut yaml };
            for (i, byte) in at {
                let n = bytes.len();
                bytes[i % n] = byte;
            }
            if cut % 3 == 0 {
                bytes.truncate(cut);
            }
            let _ = read_with(&String::from_utf8_lossy(&yaml), &image);
        }
    }
}

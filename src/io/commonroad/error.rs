//! Errors of the reader: of the file as a whole, or a list of those of its elements.

use crate::io::files::InputError;
use crate::io::kind::FileKind;
use crate::number::Short;

/// Location of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub file: String,
    /// Line, 1-based.
    pub line: u32,
    /// The element and its ancestors below the root: `lanelet 12, leftBound`.
    pub element: String,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}: {}", self.file, self.line, self.element)
    }
}

/// Why a scenario could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The file cannot be read, or is not text.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file of another kind.
    #[error("{file}: this is {kind}, expected a CommonRoad scenario (<commonRoad>); {}", kind.reader())]
    OtherKind {
        /// The file.
        file: String,
        /// Its kind.
        kind: FileKind,
    },
    /// Not well-formed XML, or XML with a document type declaration.
    #[error("{file}:{line}: not XML: {source}")]
    NotXml {
        /// The file.
        file: String,
        /// Line, 1-based.
        line: usize,
        /// The parser's reason.
        source: roxmltree::Error,
    },
    /// More XML than a scenario has.
    #[error("{file}: has more than {most} XML elements, texts and comments, expected at most these")]
    TooManyNodes {
        /// The file.
        file: String,
        /// Most nodes.
        most: u32,
    },
    /// XML of an unknown kind.
    #[error("{place}: the root element is <{found}>, expected <commonRoad>: not a CommonRoad scenario")]
    WrongRoot {
        /// Location.
        place: Place,
        /// Name of the root element.
        found: String,
    },
    /// A version that this reader does not know.
    #[error("{place}: commonRoadVersion is \"{found}\", expected 2018b or 2020a")]
    UnsupportedVersion {
        /// Location.
        place: Place,
        /// The version.
        found: String,
    },
    /// Missing or invalid elements.
    #[error(transparent)]
    Elements(#[from] ElementErrors),
}

/// What is wrong with one element.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ElementError {
    /// A required element or attribute is missing.
    #[error("{place}: has no {expected}")]
    Missing {
        /// Location of the element that lacks it.
        place: Place,
        /// What is missing.
        expected: &'static str,
    },
    /// A value of the wrong type or out of its range.
    #[error("{place}: is \"{found}\", expected {expected}")]
    BadValue {
        /// Location.
        place: Place,
        /// The value, at most its first 40 characters.
        found: String,
        /// The values that are valid.
        expected: &'static str,
    },
    /// An interval or a region, where a proof needs an exact value.
    #[error("{place}: is uncertain by {:.4}, expected {expected}", Short(*width))]
    Uncertain {
        /// Location.
        place: Place,
        /// Width of the interval, or diagonal of the region, in the unit of the element.
        width: f64,
        /// The widths that are valid.
        expected: &'static str,
    },
    /// A state of an obstacle that it cannot reach from the state before.
    #[error("{place}: is {:.1} m from the state before it, at {:.0} m/s; expected {expected}", Short(*distance), Short(*speed))]
    Unreachable {
        /// Location of the later state.
        place: Place,
        /// Distance of the two states, m.
        distance: f64,
        /// Mean speed between them, m/s.
        speed: f64,
        /// The speeds that are valid.
        expected: &'static str,
    },
    /// A line or polygon with too few or too many distinct points.
    #[error("{place}: has {found} point(s), expected {expected}")]
    BadPoints {
        /// Location.
        place: Place,
        /// Number of points.
        found: usize,
        /// The numbers that are valid.
        expected: &'static str,
    },
    /// Two elements of one kind with the same id.
    #[error("{place}: duplicate id, also that of line {first}; expected an id for each element")]
    DuplicateId {
        /// Location of the second element.
        place: Place,
        /// Line of the first element.
        first: u32,
    },
    /// A goal region of lanelets none of which exists.
    #[error("{place}: refers to lanelet(s) {ids}, expected ids of lanelets in the file")]
    NoSuchLanelet {
        /// Location.
        place: Place,
        /// The ids, separated by commas.
        ids: String,
    },
    /// No planning problem, so there is no start and no goal.
    #[error("{place}: has no planningProblem")]
    NoPlanningProblem {
        /// Location of the root element.
        place: Place,
    },
}

impl ElementError {
    /// Location of the error.
    #[must_use]
    pub fn place(&self) -> &Place {
        match self {
            Self::Missing { place, .. }
            | Self::BadValue { place, .. }
            | Self::Uncertain { place, .. }
            | Self::Unreachable { place, .. }
            | Self::BadPoints { place, .. }
            | Self::DuplicateId { place, .. }
            | Self::NoSuchLanelet { place, .. }
            | Self::NoPlanningProblem { place } => place,
        }
    }
}

/// The errors of a file's elements, at least one, in order of their lines. An element that contains an error is skipped,
/// so an error has no consequential errors in this list.
///
/// The message has one line for each of the first 20 errors, and the number of the others.
#[derive(Debug)]
pub struct ElementErrors {
    first: Vec<ElementError>,
    total: usize,
}

impl ElementErrors {
    /// Most errors stored, so that the memory does not grow with a file made of errors.
    const STORED: usize = 1000;
    /// Most errors printed.
    const PRINTED: usize = 20;

    pub(super) fn none() -> Self {
        Self { first: Vec::new(), total: 0 }
    }

    #[cfg(test)]
    pub(super) fn pop(&mut self) -> Option<ElementError> {
        self.first.pop()
    }

    pub(super) fn push(&mut self, error: ElementError) {
        self.first.push(error);
        self.total += 1;
        if self.first.len() >= 2 * Self::STORED {
            self.sort();
        }
    }

    /// Orders the errors by line, those of one line as they were found, and drops those beyond the limit.
    pub(super) fn sort(&mut self) {
        self.first.sort_by_key(|error| error.place().line);
        self.first.truncate(Self::STORED);
    }

    /// The first errors of the file, at most a thousand.
    #[must_use]
    pub fn first(&self) -> &[ElementError] {
        &self.first
    }

    /// Number of all errors.
    #[must_use]
    pub fn total(&self) -> usize {
        self.total
    }
}

impl std::fmt::Display for ElementErrors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (i, error) in self.first.iter().take(Self::PRINTED).enumerate() {
            let separator = if i == 0 { "" } else { "\n" };
            write!(f, "{separator}{error}")?;
        }
        match self.total.saturating_sub(Self::PRINTED) {
            0 => Ok(()),
            more => write!(f, "\n… and {more} more"),
        }
    }
}

impl std::error::Error for ElementErrors {}

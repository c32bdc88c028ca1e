//! What can be so wrong with a scenario file that it is not read.

use crate::io::files::InputError;

/// Where in a file something is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub file: String,
    /// Line, 1-based.
    pub line: u32,
    /// The element and those around it: `lanelet 12, leftBound`.
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
    /// The file cannot be read, whatever is in it.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The file is not well-formed XML, or declares a document type.
    #[error("{file}:{line}: not XML that this program reads: {source}")]
    NotXml {
        /// The file.
        file: String,
        /// Line.
        line: u32,
        /// What the parser met.
        source: roxmltree::Error,
    },
    /// XML of another kind.
    #[error("{place}: the root element is <{found}>, expected <commonRoad>: not a CommonRoad scenario")]
    WrongRoot {
        /// Where.
        place: Place,
        /// Name of the root element.
        found: String,
    },
    /// A version that this reader does not know.
    #[error("{place}: commonRoadVersion is \"{found}\", expected 2018b or 2020a")]
    UnsupportedVersion {
        /// Where.
        place: Place,
        /// The version.
        found: String,
    },
    /// Nothing to plan.
    #[error("{file}: has no <planningProblem>")]
    NoPlanningProblem {
        /// The file.
        file: String,
    },
    /// A required element or attribute is not there.
    #[error("{place}: has no {expected}")]
    Missing {
        /// Where.
        place: Place,
        /// What is missing.
        expected: &'static str,
    },
    /// A value is not what it has to be: not a number, not finite, out of its range.
    #[error("{place}: \"{found}\", expected {expected}")]
    BadValue {
        /// Where.
        place: Place,
        /// What is there.
        found: String,
        /// What should be there.
        expected: &'static str,
    },
    /// A line or polygon with too few distinct points.
    #[error("{place}: has {found} point(s), expected {expected}")]
    BadPoints {
        /// Where.
        place: Place,
        /// How many points there are.
        found: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// Two elements with the same id, of which only one could be meant.
    #[error("{place}: the id is already taken by an element before it")]
    DuplicateId {
        /// Where.
        place: Place,
    },
    /// A goal region of lanelets none of which exists.
    #[error("{place}: none of the lanelets that it names exists")]
    NoSuchLanelet {
        /// Where.
        place: Place,
    },
}

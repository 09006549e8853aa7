//! One error type for all formats: what is wrong and where in the bytes. The caller knows the path and puts it in front.

use std::fmt;

/// Where in a file something is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Byte offset from the start of the file.
    Offset(u64),
    /// Line and column of a text file, both from 1.
    Line {
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
    },
    /// The file as a whole.
    File,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Offset(offset) => write!(f, "byte {offset}"),
            Place::Line { line, column } => write!(f, "line {line}, column {column}"),
            Place::File => write!(f, "file"),
        }
    }
}

/// A file that cannot be used, with the place, the reason and what to do about it on one line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {message}{}", Tail(suggestion))]
pub struct FormatError {
    /// Where.
    pub place: Place,
    /// What is wrong there, one line.
    pub message: String,
    /// What was probably meant, or what may stand there, one line.
    pub suggestion: Option<String>,
}

/// A suggestion behind a message.
struct Tail<'a>(&'a Option<String>);

impl fmt::Display for Tail<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.as_ref().map_or(Ok(()), |s| write!(f, "; {s}"))
    }
}

impl FormatError {
    /// An error at a byte offset.
    pub fn at(offset: u64, message: impl Into<String>) -> Self {
        Self {
            place: Place::Offset(offset),
            message: message.into(),
            suggestion: None,
        }
    }

    /// An error of the file as a whole.
    pub fn file(message: impl Into<String>) -> Self {
        Self {
            place: Place::File,
            message: message.into(),
            suggestion: None,
        }
    }

    /// An error at a line and column, both from 1.
    pub fn line(line: u32, column: u32, message: impl Into<String>) -> Self {
        Self {
            place: Place::Line { line, column },
            message: message.into(),
            suggestion: None,
        }
    }

    /// The same with what was probably meant, or what may stand there; of several suggestions the last counts. Like messages it is
    /// kept to one line of bearable length.
    pub fn suggest(mut self, suggestion: impl Into<Option<String>>) -> Self {
        self.suggestion = suggestion.into().map(one_line).or(self.suggestion);
        self
    }
}

/// Longest message, in characters.
const MAX_MESSAGE: usize = 400;

/// A message in which names and values of a file may be: one line of bearable length.
pub(crate) fn one_line(message: impl AsRef<str>) -> String {
    let clean = |c: char| if c.is_control() { ' ' } else { c };
    message.as_ref().chars().take(MAX_MESSAGE).map(clean).collect()
}

//! What is wrong with a file of a database: for people one line, `path: place: reason; suggestion`, for programs the same in parts.
//!
//! Any thread.

use std::fmt;
use std::io;

use brickfell_formats::{FormatError, Place};
use brickfell_pager::Store;
use serde::ser::{Serialize, SerializeMap, Serializer};

/// A fault of a file. As JSON an object with `path` and `message`; `line` and `column`, or `byte`, where the place is known; and
/// `suggestion` if there is one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fault {
    path: String,
    error: FormatError,
}

impl Fault {
    /// A fault of a file of a database.
    pub(crate) fn new(store: &dyn Store, name: &str, error: FormatError) -> Self {
        Self {
            path: store.describe(name).replace(['\n', '\r'], " "),
            error,
        }
    }

    /// A file that cannot be read; `what` is what cannot be done.
    pub(crate) fn unreadable(store: &dyn Store, name: &str, what: &str, error: &io::Error) -> Self {
        let text = format!("cannot be {what}: {error}");
        Self::new(store, name, FormatError::file(text.replace(['\n', '\r'], " ")))
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path, self.error)
    }
}

impl From<Fault> for String {
    fn from(fault: Fault) -> Self {
        fault.to_string()
    }
}

impl Serialize for Fault {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("path", &self.path)?;
        match self.error.place {
            Place::Line { line, column } => {
                map.serialize_entry("line", &line)?;
                map.serialize_entry("column", &column)?;
            }
            Place::Offset(byte) => map.serialize_entry("byte", &byte)?,
            Place::File => {}
        }
        map.serialize_entry("message", &self.error.message)?;
        if let Some(suggestion) = &self.error.suggestion {
            map.serialize_entry("suggestion", suggestion)?;
        }
        map.end()
    }
}

//! An element with its attributes: their syntax, their values, and errors that name them.

use std::borrow::Cow;

use quick_xml::XmlVersion;
use quick_xml::escape::EscapeError;
use quick_xml::events::attributes::{AttrError, Attributes};

use super::error_at;
use crate::error::FormatError;
use crate::octree::MAX_METRES;
use crate::words::{self, Kind, nearest};

/// Most attributes an element may have.
const MAX_ATTRIBUTES: usize = 64;

/// An element's name, attributes and place.
#[derive(Debug)]
pub(crate) struct Element<'a> {
    text: &'a str,
    at: usize,
    /// The name as written.
    pub(crate) name: &'a str,
    pub(super) attributes: Vec<Attribute<'a>>,
}

/// An attribute's value and place.
#[derive(Clone, Debug)]
pub(crate) struct Attribute<'a> {
    text: &'a str,
    at: usize,
    element: &'a str,
    name: &'a str,
    value: Cow<'a, str>,
}

/// Where `part`, a slice of `whole`, begins in it.
fn offset_in(whole: &str, part: &str) -> usize {
    (part.as_ptr() as usize)
        .saturating_sub(whole.as_ptr() as usize)
        .min(whole.len())
}

impl<'a> Element<'a> {
    /// The element whose `<` is at `at`, with `len` bytes between `<` and `>` (or `/>`).
    pub(super) fn read(text: &'a str, at: usize, len: usize, name_len: usize) -> Result<Self, FormatError> {
        let content = text.get(at + 1..at + 1 + len).unwrap_or_default();
        let name = content.get(..name_len).unwrap_or_default();
        if name.is_empty() {
            return Err(error_at(text, at, "an element without a name"));
        }
        let mut element = Self {
            text,
            at,
            name,
            attributes: Vec::new(),
        };
        for attribute in Attributes::new(content, name_len) {
            let attribute = attribute.map_err(|e| element.attribute_fault(content, e))?;
            let key = attribute.key.into_inner();
            let place = at + 1 + offset_in(content, key);
            let fault = |what: &str| Err(error_at(text, place, format!("{name}: attribute {key} {what}")));
            if !text
                .get(..place)
                .is_some_and(|t| t.ends_with(|c: char| c.is_ascii_whitespace()))
            {
                return fault("needs a space before it");
            }
            if element.attributes.len() == MAX_ATTRIBUTES {
                return fault("is one too many");
            }
            if attribute.value.contains('<') {
                return fault("contains '<' (write &lt;)");
            }
            let value = attribute.normalized_value(XmlVersion::Explicit1_0).map_err(|e| {
                let what = match e {
                    quick_xml::Error::Escape(EscapeError::UnrecognizedEntity(_, entity)) => {
                        format!("has an unknown entity {entity:?}")
                    }
                    e => format!("is not well-formed: {}", e),
                };
                error_at(text, place, format!("{name}: attribute {key} {what}"))
            })?;
            element.attributes.push(Attribute {
                text,
                at: place,
                element: name,
                name: key,
                value,
            });
        }
        Ok(element)
    }
    /// An error at the element's `<`.
    pub(crate) fn error(&self, message: impl std::fmt::Display) -> FormatError {
        error_at(self.text, self.at, format!("{}: {message}", self.name))
    }

    fn attribute_fault(&self, content: &str, error: AttrError) -> FormatError {
        let (at, what) = match error {
            AttrError::Duplicated(at, _) => {
                let rest = content.get(at..).unwrap_or_default();
                let end = rest
                    .find(|c: char| c == '=' || c.is_ascii_whitespace())
                    .unwrap_or(rest.len());
                (
                    at,
                    format!("attribute {} is given twice", rest.get(..end).unwrap_or_default()),
                )
            }
            AttrError::ExpectedEq(at) => (at, "an attribute has no value (name=\"value\")".to_string()),
            AttrError::ExpectedValue(at) | AttrError::UnquotedValue(at) | AttrError::ExpectedQuote(at, _) => {
                (at, "an attribute's value is not in quotes".to_string())
            }
        };
        error_at(self.text, self.at + 1 + at, format!("{}: {what}", self.name))
    }

    /// The attributes that elements of a kind do not have, each with the error that it is.
    pub(crate) fn unknown(&self, kind: &Kind) -> impl Iterator<Item = (&'a str, FormatError)> {
        let known = |a: &&Attribute| kind.words().any(|w| w.name == a.name);
        self.attributes.iter().filter(move |a| !known(a)).map(|a| {
            let message = format!("{}: attribute {} is unknown", self.name, a.name);
            (
                a.name,
                error_at(a.text, a.at, message).suggest(kind.about(a.name)),
            )
        })
    }

    /// Refuses attributes that elements of a kind do not have.
    pub(crate) fn allow(&self, kind: &Kind) -> Result<(), FormatError> {
        self.unknown(kind).next().map_or(Ok(()), |(_, e)| Err(e))
    }

    /// An attribute that may be missing.
    pub(crate) fn optional(&self, name: &str) -> Option<&Attribute<'a>> {
        self.attributes.iter().find(|a| a.name == name)
    }

    /// An attribute that must be there.
    pub(crate) fn required(&self, name: &str) -> Result<&Attribute<'a>, FormatError> {
        self.optional(name).ok_or_else(|| {
            self.error(format!("attribute {name} is missing"))
                .suggest(words::example(name))
        })
    }

    /// Three lengths or coordinates, in metres.
    pub(crate) fn metres3(&self, names: [&str; 3]) -> Result<[f64; 3], FormatError> {
        let [x, y, z] = names.map(|n| self.required(n).and_then(Attribute::metres));
        Ok([x?, y?, z?])
    }

    /// Whether any of the attributes is there.
    pub(crate) fn has_any(&self, names: &[&str]) -> bool {
        names.iter().any(|n| self.optional(n).is_some())
    }
}

impl<'a> Attribute<'a> {
    /// The whole text that the attribute stands in.
    pub(crate) fn text(&self) -> &'a str {
        self.text
    }

    /// Where in the text its name begins, in bytes.
    pub(crate) fn at(&self) -> usize {
        self.at
    }

    /// The value with entities resolved.
    pub(crate) fn value(&self) -> &str {
        &self.value
    }

    /// An error at the attribute: `Element: Name="value" message`.
    pub(crate) fn error(&self, message: impl std::fmt::Display) -> FormatError {
        let mut value: String = self.value.chars().take(80).collect();
        if value.len() < self.value.len() {
            value.push('…');
        }
        let message = format!("{}: {}=\"{}\" {message}", self.element, self.name, &value);
        error_at(self.text, self.at, message)
    }

    /// A finite coordinate or length, in metres.
    pub(crate) fn metres(&self) -> Result<f64, FormatError> {
        match self.value.parse::<f64>() {
            Err(_) => Err(self.error("is not a number").suggest(self.as_metres())),
            Ok(v) if !v.is_finite() => Err(self
                .error("is not a finite number")
                .suggest(words::example(self.name))),
            Ok(v) if v.abs() > MAX_METRES => Err(self.error(format!("is beyond ±{MAX_METRES:e} m"))),
            Ok(v) => Ok(v),
        }
    }

    /// A value that is no number as one that is: without unit or blanks, with a decimal point. Else an example.
    fn as_metres(&self) -> Option<String> {
        let bare = self.value.trim().trim_end_matches(char::is_alphabetic).trim_end();
        let number = bare.replacen(',', ".", 1);
        match number.parse::<f64>() {
            Ok(v) if v.is_finite() => Some(format!("did you mean {}=\"{number}\"?", self.name)),
            _ => words::example(self.name),
        }
    }

    /// A whole number, not negative.
    pub(crate) fn integer<T: std::str::FromStr>(&self) -> Result<T, FormatError> {
        let digits = !self.value.is_empty() && self.value.bytes().all(|b| b.is_ascii_digit());
        match self.value.parse() {
            Ok(v) if digits => Ok(v),
            _ if digits => Err(self.error("is too large")),
            _ => Err(self
                .error("is not a whole number")
                .suggest(words::example(self.name))),
        }
    }

    /// `YES` or `NO`.
    pub(crate) fn yes_no(&self) -> Result<bool, FormatError> {
        self.choice(&[("YES", true), ("NO", false)])
    }

    /// One of some words.
    pub(crate) fn choice<T: Copy>(&self, words: &[(&str, T)]) -> Result<T, FormatError> {
        words
            .iter()
            .find(|(word, _)| *word == self.value)
            .map(|(_, v)| *v)
            .ok_or_else(|| {
                let known: Vec<&str> = words.iter().map(|(word, _)| *word).collect();
                let meant = nearest(&self.value, known.iter().copied());
                self.error(format!("is unknown (known: {})", known.join(", ")))
                    .suggest(meant.map(|word| format!("did you mean {word}?")))
            })
    }
}

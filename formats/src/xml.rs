//! The strict XML subset that both text formats share: elements and attributes, no text content, every error with its
//! line and column.
//!
//! Works on the whole file in memory and borrows from it. Comments and processing instructions are skipped; document types,
//! text, CDATA, a second root and everything that is not well-formed are errors. Columns count characters.

use std::borrow::Cow;

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::escape::EscapeError;
use quick_xml::events::Event;
use quick_xml::events::attributes::{AttrError, Attributes};

use crate::error::FormatError;
use crate::octree::MAX_METRES;

/// Most attributes an element may have.
const MAX_ATTRIBUTES: usize = 64;

/// A step through the document.
#[derive(Debug)]
pub(crate) enum Token<'a> {
    /// An element begins.
    Open(Element<'a>),
    /// The innermost open element ends.
    Close,
    /// The document ends.
    End,
}

/// Reads a document token by token.
pub(crate) struct Document<'a> {
    text: &'a str,
    reader: Reader<&'a [u8]>,
    open: Vec<&'a str>,
    root_seen: bool,
}

/// An element's name, attributes and place.
#[derive(Debug)]
pub(crate) struct Element<'a> {
    text: &'a str,
    at: usize,
    /// The name as written.
    pub(crate) name: &'a str,
    attributes: Vec<Attribute<'a>>,
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

/// The error at a byte offset of a text.
fn error_at(text: &str, at: usize, message: impl Into<String>) -> FormatError {
    let before = text.get(..at.min(text.len())).unwrap_or(text);
    let line = before.bytes().filter(|b| *b == b'\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    FormatError::line(
        u32::try_from(line).unwrap_or(u32::MAX),
        u32::try_from(column).unwrap_or(u32::MAX),
        message,
    )
}

impl<'a> Document<'a> {
    /// A document over the bytes of a file.
    ///
    /// # Errors
    /// If they are not UTF-8.
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, FormatError> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let text = std::str::from_utf8(bytes).map_err(|e| {
            let valid = bytes.get(..e.valid_up_to()).unwrap_or_default();
            let text = std::str::from_utf8(valid).unwrap_or_default();
            error_at(text, text.len(), "the file is not UTF-8 text")
        })?;
        let mut reader = Reader::from_str(text);
        let config = reader.config_mut();
        config.expand_empty_elements = true;
        config.check_comments = true;
        Ok(Self {
            text,
            reader,
            open: Vec::new(),
            root_seen: false,
        })
    }

    /// The next token.
    ///
    /// # Errors
    /// What is not well-formed or outside the subset.
    pub(crate) fn next(&mut self) -> Result<Token<'a>, FormatError> {
        loop {
            let at = self.reader.buffer_position() as usize;
            let fault = |what: &str| error_at(self.text, at, what);
            match self.reader.read_event() {
                Ok(Event::Start(tag)) => {
                    if self.open.is_empty() && std::mem::replace(&mut self.root_seen, true) {
                        return Err(fault("a second root element"));
                    }
                    let element = self.element(at, tag.len(), tag.name().into_inner().len())?;
                    self.open.push(element.name);
                    return Ok(Token::Open(element));
                }
                Ok(Event::End(_)) => {
                    self.open.pop();
                    return Ok(Token::Close);
                }
                Ok(Event::Eof) => {
                    return match self.open.last() {
                        Some(name) => Err(fault(&format!("the file ends inside element {name}"))),
                        None if !self.root_seen => Err(fault("the file has no root element")),
                        None => Ok(Token::End),
                    };
                }
                Ok(Event::Decl(decl)) => {
                    if at != 0 {
                        return Err(fault("an XML declaration may only begin the file"));
                    }
                    let utf8 =
                        |e: &str| e.eq_ignore_ascii_case("utf-8") || e.eq_ignore_ascii_case("us-ascii");
                    match decl.encoding() {
                        Some(Ok(encoding)) if !utf8(&encoding) => {
                            return Err(fault(&format!(
                                "encoding {:?} is not read, only UTF-8",
                                &*encoding
                            )));
                        }
                        Some(Err(_)) => return Err(fault("the XML declaration is not well-formed")),
                        _ => {}
                    }
                }
                Ok(Event::Text(text)) => {
                    let Some(inside) = text.find(|c: char| !c.is_ascii_whitespace()) else {
                        continue;
                    };
                    return Err(self.text_fault(at + inside));
                }
                Ok(Event::CData(_) | Event::GeneralRef(_)) => return Err(self.text_fault(at)),
                Ok(Event::DocType(_)) => return Err(fault("a document type is not allowed")),
                Ok(Event::Comment(_) | Event::PI(_)) => {}
                // Does not come: empty elements are expanded.
                Ok(Event::Empty(_)) => return Err(fault("an unexpected empty element")),
                Err(e) => {
                    let at = self.reader.error_position() as usize;
                    return Err(error_at(self.text, at, one_line(&e.to_string())));
                }
            }
        }
    }

    fn text_fault(&self, at: usize) -> FormatError {
        let place = self
            .open
            .last()
            .map_or("outside the root element".to_string(), |n| format!("in {n}"));
        error_at(
            self.text,
            at,
            format!("text {place}, where only elements are allowed"),
        )
    }

    /// The element whose `<` is at `at`, with `len` bytes between `<` and `>` (or `/>`).
    fn element(&self, at: usize, len: usize, name_len: usize) -> Result<Element<'a>, FormatError> {
        let text = self.text;
        let content = text.get(at + 1..at + 1 + len).unwrap_or_default();
        let name = content.get(..name_len).unwrap_or_default();
        if name.is_empty() {
            return Err(error_at(text, at, "an element without a name"));
        }
        let mut element = Element {
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
                    e => format!("is not well-formed: {}", one_line(&e.to_string())),
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
}

/// Where `part`, a slice of `whole`, begins in it.
fn offset_in(whole: &str, part: &str) -> usize {
    (part.as_ptr() as usize)
        .saturating_sub(whole.as_ptr() as usize)
        .min(whole.len())
}

fn one_line(message: &str) -> String {
    message.replace(|c: char| c.is_control(), " ")
}

impl<'a> Element<'a> {
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

    /// Refuses attributes that are not in the list.
    pub(crate) fn allow(&self, known: &[&str]) -> Result<(), FormatError> {
        match self.attributes.iter().find(|a| !known.contains(&a.name)) {
            Some(a) => Err(error_at(
                a.text,
                a.at,
                format!("{}: attribute {} is unknown", self.name, one_line(a.name)),
            )),
            None => Ok(()),
        }
    }

    /// An attribute that may be missing.
    pub(crate) fn optional(&self, name: &str) -> Option<&Attribute<'a>> {
        self.attributes.iter().find(|a| a.name == name)
    }

    /// An attribute that must be there.
    pub(crate) fn required(&self, name: &str) -> Result<&Attribute<'a>, FormatError> {
        self.optional(name)
            .ok_or_else(|| self.error(format!("attribute {name} is missing")))
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

impl Attribute<'_> {
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
        let message = format!(
            "{}: {}=\"{}\" {message}",
            self.element,
            self.name,
            one_line(&value)
        );
        error_at(self.text, self.at, message)
    }

    /// A finite coordinate or length, in metres.
    pub(crate) fn metres(&self) -> Result<f64, FormatError> {
        match self.value.parse::<f64>() {
            Err(_) => Err(self.error("is not a number")),
            Ok(v) if !v.is_finite() => Err(self.error("is not a finite number")),
            Ok(v) if v.abs() > MAX_METRES => Err(self.error(format!("is beyond ±{MAX_METRES:e} m"))),
            Ok(v) => Ok(v),
        }
    }

    /// A whole number, not negative.
    pub(crate) fn integer<T: std::str::FromStr>(&self) -> Result<T, FormatError> {
        let digits = !self.value.is_empty() && self.value.bytes().all(|b| b.is_ascii_digit());
        match self.value.parse() {
            Ok(v) if digits => Ok(v),
            _ if digits => Err(self.error("is too large")),
            _ => Err(self.error("is not a whole number")),
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
                self.error(format!("is unknown (known: {})", known.join(", ")))
            })
    }
}

/// Appends ` name="value"`, escaped so that [`Document`] reads the same value back. Control characters that XML cannot carry
/// become U+FFFD.
pub(crate) fn write_text(out: &mut String, name: &str, value: &str) {
    out.push(' ');
    out.push_str(name);
    out.push_str("=\"");
    for c in value.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\t' => out.push_str("&#9;"),
            '\n' => out.push_str("&#10;"),
            '\r' => out.push_str("&#13;"),
            '\0'..='\x1f' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out.push('"');
}

/// Appends ` name="value"` with the shortest decimal that reads back as the same double.
pub(crate) fn write_f64(out: &mut String, name: &str, value: f64) {
    let small = value != 0.0 && value.abs() < 1e-5;
    write_text(
        out,
        name,
        &if small {
            format!("{value:e}")
        } else {
            format!("{value}")
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Place;

    fn walk(text: &str) -> Result<Vec<String>, FormatError> {
        let mut document = Document::new(text.as_bytes())?;
        let mut names = Vec::new();
        loop {
            match document.next()? {
                Token::Open(e) => names.push(format!("{}{}", e.name, e.attributes.len())),
                Token::Close => names.push("/".into()),
                Token::End => return Ok(names),
            }
        }
    }

    #[test]
    fn elements_come_in_order_and_empty_ones_close() {
        let text = "\u{feff}<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- c --><a x='1'>\n <b/><b y=\"&lt;2\" z=''></b>\n</a>\n";
        assert_eq!(walk(text).unwrap(), ["a1", "b0", "/", "b2", "/", "/"]);
    }

    #[test]
    fn what_is_outside_the_subset_is_an_error_with_its_place() {
        for (text, line, column, part) in [
            ("", 1, 1, "no root element"),
            ("<a>\n  <b>", 2, 6, "ends inside element b"),
            ("<a>\n<b></a>", 2, 4, "`</b>`"),
            ("<a/>\n<b/>", 2, 1, "second root"),
            ("<a>é x</a>", 1, 4, "text in a"),
            ("<a>\n  &amp;</a>", 2, 3, "text in a"),
            ("<a>\n <![CDATA[x]]></a>", 2, 2, "text in a"),
            ("x<a/>", 1, 1, "text outside the root"),
            ("<!DOCTYPE a><a/>", 1, 1, "document type"),
            ("<a é='1' é='2'/>", 1, 10, "attribute é is given twice"),
            ("<a b='1'c='2'/>", 1, 9, "needs a space"),
            ("<a b=1/>", 1, 6, "not in quotes"),
            ("<a\n b/>", 2, 3, "no value"),
            ("<a b='<'/>", 1, 4, "contains '<'"),
            ("<a b='&x;'/>", 1, 4, "unknown entity"),
            ("<a b='&#0;'/>", 1, 4, "not well-formed"),
            ("< a='1'/>", 1, 1, "without a name"),
            ("<?xml version='1.0' encoding='latin1'?><a/>", 1, 1, "only UTF-8"),
            ("<a/>\n<?xml version='1.0'?>", 2, 1, "may only begin"),
        ] {
            let e = walk(text).unwrap_err();
            assert_eq!(e.place, Place::Line { line, column }, "{text:?}: {e}");
            assert!(e.message.contains(part), "{text:?}: {e}");
        }
        let e = Document::new(b"<a>\n\xff</a>").err().unwrap();
        assert_eq!(e.place, Place::Line { line: 2, column: 1 });
    }

    #[test]
    fn numbers_round_trip_and_bad_ones_are_errors() {
        for v in [
            0.0,
            -0.0,
            0.1,
            1.0 / 3.0,
            1e15,
            -123_456.789_012_345,
            5e-324,
            1e-9,
            f64::MIN_POSITIVE,
        ] {
            let mut text = "<a".to_string();
            write_f64(&mut text, "v", v);
            text.push_str("/>");
            let Token::Open(e) = Document::new(text.as_bytes()).unwrap().next().unwrap() else {
                panic!()
            };
            assert_eq!(
                e.required("v").unwrap().metres().unwrap().to_bits(),
                v.to_bits(),
                "{text}"
            );
        }
        for bad in [
            "",
            "x",
            "NaN",
            "inf",
            "-infinity",
            "1e400",
            "1,5",
            " 1",
            "2e15",
            "0x10",
        ] {
            let text = format!("<a v=\"{bad}\"/>");
            let Token::Open(e) = Document::new(text.as_bytes()).unwrap().next().unwrap() else {
                panic!()
            };
            let e = e.required("v").unwrap().metres().unwrap_err();
            assert!(e.message.starts_with(&format!("a: v=\"{bad}\" is ")), "{e}");
        }
        for (bad, why) in [
            ("", "not a whole"),
            ("-1", "not a whole"),
            ("+1", "not a whole"),
            ("4294967296", "too large"),
        ] {
            let text = format!("<a v=\"{bad}\"/>");
            let Token::Open(e) = Document::new(text.as_bytes()).unwrap().next().unwrap() else {
                panic!()
            };
            assert!(
                e.required("v")
                    .unwrap()
                    .integer::<u32>()
                    .unwrap_err()
                    .message
                    .contains(why)
            );
        }
    }
}

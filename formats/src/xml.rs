//! The strict XML subset that both text formats share: elements and attributes, no text content, every error with its
//! line and column.
//!
//! Works on the whole file in memory and borrows from it. Comments and processing instructions are skipped; document types,
//! text, CDATA, a second root and everything that is not well-formed are errors. Columns count characters.

mod element;
#[cfg(test)]
mod tests;
mod write;

use quick_xml::Reader;
use quick_xml::errors::IllFormedError;
use quick_xml::events::Event;

pub(crate) use element::{Attribute, Element};
pub(crate) use write::{write_f64, write_text};

use crate::error::{FormatError, one_line};

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

/// The error at a byte offset of a text. Names and values in the message come from the file: it is kept to one line of
/// bearable length.
fn error_at(text: &str, at: usize, message: impl AsRef<str>) -> FormatError {
    let before = text.get(..at.min(text.len())).unwrap_or(text);
    let line = before.bytes().filter(|b| *b == b'\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    FormatError::line(
        u32::try_from(line).unwrap_or(u32::MAX),
        u32::try_from(column).unwrap_or(u32::MAX),
        one_line(message),
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
        // The reader would swallow a second byte order mark and count places from behind it.
        if text.starts_with('\u{feff}') {
            return Err(error_at(
                text,
                0,
                "text outside the root element, where only elements are allowed",
            ));
        }
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
                    let element = Element::read(self.text, at, tag.len(), tag.name().into_inner().len())?;
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
                    let fault = error_at(self.text, at, e.to_string());
                    return Err(match e {
                        quick_xml::Error::IllFormed(IllFormedError::DoubleHyphenInComment) => {
                            fault.suggest("a comment ends with --> and has no -- before".to_string())
                        }
                        _ => fault,
                    });
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
}

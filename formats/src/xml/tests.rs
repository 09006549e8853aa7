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
        ("\u{feff}\u{feff}<a/>", 1, 1, "text outside the root"),
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

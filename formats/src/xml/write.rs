//! Writes attributes that read back as the same values.

/// Appends ` name="value"`, escaped so that [`super::Document`] reads the same value back. Control characters that XML cannot carry
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

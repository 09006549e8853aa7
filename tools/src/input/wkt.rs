//! Well-known text of coordinate systems (WKT 1 and 2): the name, the code and the units. The projection is read by [`crs`].

use super::crs::{self, Crs};

/// What the builder needs of a coordinate system.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct System {
    /// `EPSG:code` where the text has one, else the name.
    pub(crate) crs: Crs,
    /// Metres per horizontal unit, where it is stated.
    pub(crate) linear_unit: Option<f64>,
    /// Metres per vertical unit, where it is stated.
    pub(crate) vertical_unit: Option<f64>,
}

/// Deepest nesting that is read; real texts stay below ten.
const MAX_DEPTH: usize = 64;

#[derive(Debug, PartialEq)]
enum Item {
    Text(String),
    Number(f64),
    Node(Node),
}

#[derive(Debug, PartialEq)]
struct Node {
    keyword: String,
    items: Vec<Item>,
}

/// Reads the text; `Err` says what is wrong with it.
pub(crate) fn parse(text: &str) -> Result<System, String> {
    let mut parser = Parser { rest: text.trim() };
    let root = match parser.item(0)? {
        Item::Node(node) => node,
        _ => return Err("the coordinate system is not well-known text".into()),
    };
    let projected = root.find(&[
        "PROJCS",
        "PROJCRS",
        "PROJECTEDCRS",
        "LOCAL_CS",
        "ENGCRS",
        "ENGINEERINGCRS",
    ]);
    let geographic = root.find(&[
        "GEOGCS",
        "GEOGCRS",
        "GEODCRS",
        "GEOGRAPHICCRS",
        "GEODETICCRS",
        "GEOCCS",
    ]);
    let vertical = root.find(&["VERT_CS", "VERTCRS", "VERTICALCRS"]);
    let Some(main) = projected.or(geographic) else {
        return Err(format!(
            "no horizontal coordinate system in the {} text",
            root.keyword
        ));
    };
    Ok(System {
        crs: Crs {
            name: main.name(),
            definition: crs::definition(text.trim()),
            geographic: projected.is_none(),
        },
        linear_unit: projected.and_then(Node::unit),
        vertical_unit: vertical.and_then(Node::unit),
    })
}

impl Node {
    fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.items.iter().filter_map(|item| match item {
            Item::Node(node) => Some(node),
            _ => None,
        })
    }

    fn is(&self, keywords: &[&str]) -> bool {
        keywords.iter().any(|k| self.keyword.eq_ignore_ascii_case(k))
    }

    /// The first node with one of the keywords, outermost first: this one or one below it.
    fn find(&self, keywords: &[&str]) -> Option<&Node> {
        if self.is(keywords) {
            Some(self)
        } else {
            self.nodes().find_map(|node| node.find(keywords))
        }
    }

    fn name(&self) -> Option<String> {
        let code = self
            .nodes()
            .find(|n| n.is(&["AUTHORITY", "ID"]))
            .and_then(|node| match node.items.as_slice() {
                [Item::Text(authority), Item::Text(code), ..] => Some(format!("{authority}:{code}")),
                [Item::Text(authority), Item::Number(code), ..] => Some(format!("{authority}:{code}")),
                _ => None,
            });
        code.or_else(|| match self.items.first() {
            Some(Item::Text(name)) if !name.is_empty() => Some(name.clone()),
            _ => None,
        })
    }

    /// Metres per unit: the system's own unit, else the one of its first axis.
    fn unit(&self) -> Option<f64> {
        let own = |node: &Node| {
            node.nodes()
                .find(|n| n.is(&["UNIT", "LENGTHUNIT"]))
                .and_then(|n| match n.items.get(1) {
                    Some(Item::Number(metres)) if metres.is_finite() && *metres > 0.0 => Some(*metres),
                    _ => None,
                })
        };
        own(self).or_else(|| self.nodes().filter(|n| n.is(&["AXIS"])).find_map(own))
    }
}

struct Parser<'a> {
    rest: &'a str,
}

impl Parser<'_> {
    fn skip_space(&mut self) {
        self.rest = self.rest.trim_start();
    }

    fn take(&mut self, expected: &[char]) -> bool {
        self.skip_space();
        match self.rest.strip_prefix(expected) {
            Some(rest) => {
                self.rest = rest;
                true
            }
            None => false,
        }
    }

    fn item(&mut self, depth: usize) -> Result<Item, String> {
        if depth > MAX_DEPTH {
            return Err("the coordinate system is nested too deeply".into());
        }
        self.skip_space();
        if let Some(rest) = self.rest.strip_prefix('"') {
            // A quote inside a text is written twice.
            let mut text = String::new();
            let mut parts = rest;
            loop {
                let (part, after) = parts
                    .split_once('"')
                    .ok_or("a quote is not closed in the coordinate system")?;
                text.push_str(part);
                match after.strip_prefix('"') {
                    Some(more) => {
                        text.push('"');
                        parts = more;
                    }
                    None => {
                        self.rest = after;
                        return Ok(Item::Text(text));
                    }
                }
            }
        }
        let end = self
            .rest
            .find(['[', '(', ',', ']', ')'])
            .unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        let word = word.trim();
        if self.take(&['[', '(']) {
            let mut items = Vec::new();
            loop {
                items.push(self.item(depth + 1)?);
                if self.take(&[']', ')']) {
                    return Ok(Item::Node(Node {
                        keyword: word.to_string(),
                        items,
                    }));
                }
                if !self.take(&[',']) {
                    return Err("a bracket is not closed in the coordinate system".into());
                }
            }
        }
        Ok(word
            .parse()
            .map_or_else(|_| Item::Text(word.to_string()), Item::Number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projected_in_feet_with_degrees_inside() {
        let crs = parse(
            r#"PROJCS["Oregon ""x""",GEOGCS["g",UNIT["degree",0.0174],AUTHORITY["EPSG","4269"]],UNIT["foot",0.3048,AUTHORITY["EPSG","9002"]]]"#,
        )
        .unwrap();
        assert_eq!(crs.crs.name.as_deref(), Some("Oregon \"x\""));
        assert_eq!((crs.linear_unit, crs.crs.geographic), (Some(0.3048), false));
    }

    #[test]
    fn compound_wkt2_with_vertical_feet() {
        let crs = parse(
            r#"COMPOUNDCRS["c",PROJCRS["p",BASEGEOGCRS["b"],CS[Cartesian,2],AXIS["e",east,LENGTHUNIT["metre",1]],ID["EPSG",2056]],VERTCRS["v",LENGTHUNIT["US survey foot",0.3048006096]]]"#,
        )
        .unwrap();
        assert_eq!(crs.crs.name.as_deref(), Some("EPSG:2056"));
        assert_eq!(
            (crs.linear_unit, crs.vertical_unit),
            (Some(1.0), Some(0.3048006096))
        );
    }

    #[test]
    fn geographic_and_broken() {
        assert!(
            parse(r#"GEOGCS["WGS 84",UNIT["degree",0.0174]]"#)
                .unwrap()
                .crs
                .geographic
        );
        assert!(parse(r#"PROJCS["a"#).is_err());
        assert!(parse("PROJCS[\"a\"").is_err());
        assert!(parse("").is_err());
        assert!(parse(&"A[".repeat(100_000)).is_err());
    }
}

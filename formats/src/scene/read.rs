//! Reads scenes, and goes on behind what is wrong in them so that all of it can be told at once.
//!
//! Any thread. What makes the rest of the text meaningless ends the reading: text that is not XML, another root, a limit.

use std::collections::BTreeMap;

use glam::DVec3;

use super::{
    Bounds, CoarseOctTree, Group, MAX_ITEMS, MAX_NESTING, PagedOctTree, Scene, VERSION, parse_brick_size,
};
use crate::error::{FormatError, Place};
use crate::words::{self, BRICK_SIZE, CENTER, Kind, MAX, MIN};
use crate::xml::{Attribute, Document, Element, Token};

/// What is open around the next element.
enum Open {
    Group(Group),
    /// A tree, or an element that is not known: whatever is in it is left out.
    Closed(&'static Kind),
    Unknown,
}

/// As [`Scene::parse_usable`].
pub(super) fn read(bytes: &[u8]) -> Result<(Scene, Vec<FormatError>), FormatError> {
    let mut faults = Vec::new();
    let mut document = Document::new(bytes)?;
    let (mut trees, mut coarse, mut groups) = (0, 0, 0);
    let (mut crs, mut root) = (None, None);
    let mut open: Vec<Open> = Vec::new();
    loop {
        let element = match document.next()? {
            Token::Open(element) => element,
            Token::Close => {
                if let Some(Open::Group(group)) = open.pop() {
                    match open.last_mut() {
                        Some(Open::Group(parent)) => parent.groups.push(group),
                        _ => root = Some(group),
                    }
                }
                continue;
            }
            Token::End => break,
        };
        let depth = open.len();
        let next = match open.last_mut() {
            None if element.name != words::ROOT.name => return Err(wrong_root(&element)),
            None => {
                groups = count(&element, groups)?;
                crs = element.optional("Crs").map(|a| a.value().to_string());
                Open::Group(group(&element, &words::ROOT, &mut faults))
            }
            Some(Open::Group(_)) if element.name == words::GROUP.name => {
                if depth == MAX_NESTING {
                    return Err(element.error(format!("groups nest deeper than {MAX_NESTING}")));
                }
                groups = count(&element, groups)?;
                Open::Group(group(&element, &words::GROUP, &mut faults))
            }
            Some(Open::Group(group)) if element.name == words::TREE.name => {
                trees = count(&element, trees)?;
                group.trees.extend(tree(&element, &words::TREE, &mut faults));
                Open::Closed(&words::TREE)
            }
            Some(Open::Group(group)) if element.name == words::COARSE.name => {
                coarse = count(&element, coarse)?;
                group.coarse.extend(coarse_tree(&element, &mut faults));
                Open::Closed(&words::COARSE)
            }
            Some(Open::Group(_)) => {
                let fault = element.error("unknown element in OctTreeGroup");
                faults.push(fault.suggest(words::GROUP.about_inside(element.name)));
                Open::Unknown
            }
            Some(Open::Closed(kind)) => {
                let fault = element.error("a tree has no elements inside");
                faults.push(fault.suggest(kind.about_inside(element.name)));
                Open::Unknown
            }
            Some(Open::Unknown) => Open::Unknown,
        };
        open.push(next);
    }
    root.map(|root| (Scene { crs, root }, faults))
        .ok_or_else(|| FormatError::file("the scene has no root group"))
}

/// As [`Scene::tree_file_places`].
pub(super) fn tree_file_places(bytes: &[u8]) -> BTreeMap<String, Place> {
    let mut places = BTreeMap::new();
    let Ok(mut document) = Document::new(bytes) else {
        return places;
    };
    // Places are counted on from the one before: a scene may have a million trees.
    let (mut at, mut line, mut column) = (0, 1, 1);
    while let Ok(token) = document.next() {
        let element = match token {
            Token::Open(element) => element,
            Token::Close => continue,
            Token::End => break,
        };
        let Some(file) = element.optional("TreeFile") else {
            continue;
        };
        for c in file.text().get(at..file.at()).unwrap_or_default().chars() {
            (line, column) = if c == '\n' {
                (line + 1, 1)
            } else {
                (line, column + 1)
            };
        }
        at = file.at();
        let place = Place::Line { line, column };
        places.entry(file.value().to_string()).or_insert(place);
    }
    places
}

fn wrong_root(element: &Element) -> FormatError {
    let about = match element.name {
        name if name == words::OCTREE.name => "an octree is named by a TreeFile of a scene".into(),
        name if words::ROOT.inside.contains(&name) => format!("write {name} inside an OctTreeGroup"),
        name => match words::nearest(name, [words::ROOT.name]) {
            Some(meant) => format!("did you mean {meant}?"),
            None => "`brickfell new` writes a scene to begin with".into(),
        },
    };
    element
        .error("unknown root element (OctTreeGroup expected)")
        .suggest(about)
}

fn count(element: &Element, so_far: usize) -> Result<usize, FormatError> {
    if so_far == MAX_ITEMS {
        return Err(element.error(format!("a scene has at most {MAX_ITEMS} of these")));
    }
    Ok(so_far + 1)
}

/// The attributes of an element, as they are read, and what is wrong with them.
struct Attributes<'e, 'a> {
    element: &'e Element<'a>,
    faults: Vec<FormatError>,
    /// Attributes that are there but misspelt, as far as one can tell.
    meant: Vec<&'static str>,
}

impl<'e, 'a> Attributes<'e, 'a> {
    fn new(element: &'e Element<'a>, kind: &Kind) -> Self {
        let (names, faults): (Vec<_>, Vec<_>) = element.unknown(kind).unzip();
        let meant = names.into_iter().filter_map(|name| kind.meant(name)).collect();
        Self {
            element,
            faults,
            meant,
        }
    }

    /// A value, or none and a fault.
    fn keep<T>(&mut self, read: Result<T, FormatError>) -> Option<T> {
        read.map_err(|fault| self.faults.push(fault)).ok()
    }

    /// A value made of an attribute that must be there.
    fn required<T>(
        &mut self,
        name: &str,
        read: impl FnOnce(&Attribute<'a>) -> Result<T, FormatError>,
    ) -> Option<T> {
        let attribute = self.element.required(name);
        if attribute.is_err() && self.meant.contains(&name) {
            return None;
        }
        self.keep(attribute.and_then(read))
    }

    fn metres3(&mut self, names: [&str; 3]) -> Option<DVec3> {
        let [x, y, z] = names.map(|name| self.required(name, Attribute::metres));
        Some(DVec3::new(x?, y?, z?))
    }

    fn above_zero(&mut self, name: &str) -> Option<f64> {
        self.required(name, |a| match a.metres()? {
            v if v > 0.0 => Ok(v),
            _ => Err(a.error("is not above zero").suggest(words::example(name))),
        })
    }

    /// The box, if there is one and nothing is wrong with it.
    fn bounds(&mut self) -> Option<Bounds> {
        if !self.element.has_any(&MIN) && !self.element.has_any(&MAX) {
            return None;
        }
        let (min, max) = (self.metres3(MIN), self.metres3(MAX));
        let (min, max) = (min?, max?);
        for axis in 0..3 {
            if min[axis] > max[axis] {
                self.required(MIN[axis], |a| -> Result<(), FormatError> {
                    let about = format!(
                        "did you mean {} and {} the other way round?",
                        MIN[axis], MAX[axis]
                    );
                    Err(a.error(format!("is above {}", MAX[axis])).suggest(about))
                });
            }
        }
        Some(Bounds { min, max })
    }

    /// What was read, unless something was wrong.
    fn finish<T>(self, value: Option<T>, faults: &mut Vec<FormatError>) -> Option<T> {
        let sound = self.faults.is_empty();
        faults.extend(self.faults);
        value.filter(|_| sound)
    }
}

fn group(element: &Element, kind: &Kind, faults: &mut Vec<FormatError>) -> Group {
    let mut read = Attributes::new(element, kind);
    if let Some(version) = element.optional("Version") {
        read.keep(version.integer::<u32>().and_then(|v| match v {
            VERSION => Ok(()),
            _ => Err(version.error(format!("is an unknown version (this reads {VERSION})"))),
        }));
    }
    let brick_size = match element.has_any(&BRICK_SIZE) {
        true => read.keep(parse_brick_size(element)),
        false => None,
    };
    let compressed = element.optional("Compressed").map(|a| a.yes_no());
    let compressed = compressed.and_then(|c| read.keep(c)).unwrap_or_default();
    let group = Group {
        compressed,
        brick_size,
        bounds: read.bounds(),
        ..Group::default()
    };
    read.finish(Some(group), faults).unwrap_or_default()
}

fn coarse_tree(element: &Element, faults: &mut Vec<FormatError>) -> Option<CoarseOctTree> {
    let tree = tree(element, &words::COARSE, faults);
    let mut read = Attributes::new(element, &words::COARSE);
    // The tree has told of these.
    read.faults.clear();
    let voxel = read.above_zero("Voxel");
    let voxel = read.finish(voxel, faults)?;
    Some(CoarseOctTree { tree: tree?, voxel })
}

fn tree(element: &Element, kind: &Kind, faults: &mut Vec<FormatError>) -> Option<PagedOctTree> {
    let mut read = Attributes::new(element, kind);
    let center = read.metres3(CENTER);
    let radius = read.above_zero("Radius");
    let tree_file = read.required("TreeFile", |file| match path_fault(file.value()) {
        None => Ok(file.value().to_string()),
        Some(why) => Err(file
            .error(format!(
                "leaves the terrain's folder or is not a file name: {why}"
            ))
            .suggest(mended(file.value()))),
    });
    let bounds = read.bounds();
    let tree = center.zip(radius).zip(tree_file);
    let tree = tree.map(|((center, radius), tree_file)| PagedOctTree {
        center,
        radius,
        bounds,
        tree_file,
    });
    read.finish(tree, faults)
}

/// Why a path is not a file below the folder it is relative to, on any platform.
fn path_fault(path: &str) -> Option<&'static str> {
    if path.is_empty() {
        return Some("it is empty");
    }
    if path.starts_with('/') {
        return Some("it is absolute");
    }
    if path.contains('\\') {
        return Some("it has a backslash (separate by /)");
    }
    if path.contains(':') {
        return Some("it has a colon (a drive or an address)");
    }
    if path.chars().any(char::is_control) {
        return Some("it has a control character");
    }
    path.split('/').find_map(|part| match part {
        ".." => Some("it has a component .."),
        "." | "" => Some("it has an empty component or ."),
        _ => None,
    })
}

/// What was probably meant by a path that is none; an example if that cannot be told.
fn mended(path: &str) -> Option<String> {
    let slashes = path.replace('\\', "/");
    let parts: Vec<&str> = slashes
        .split('/')
        .filter(|p| !p.is_empty() && *p != ".")
        .collect();
    let mended = parts.join("/");
    if path.starts_with('/') || path_fault(&mended).is_some() {
        return words::example("TreeFile");
    }
    Some(format!("did you mean TreeFile=\"{mended}\"?"))
}

//! The words of both XML formats: which elements there are, what they hold, which attributes they have.
//!
//! Readers refuse whatever is not in these tables, suggestions come from them, and tests hold `docs/scene.xsd` and
//! `docs/octree.xsd` to them. Pure data and functions: any thread.

/// An attribute that an element may have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Word {
    pub(crate) name: &'static str,
    /// Whether the element must have it.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests hold readers and schemas to it"))]
    pub(crate) needed: bool,
    /// A value to show to who left it out or wrote another that cannot be.
    pub(crate) example: &'static str,
}

/// An element.
#[derive(Debug)]
pub(crate) struct Kind {
    pub(crate) name: &'static str,
    /// Its attributes, in groups that several elements share.
    attributes: &'static [&'static [Word]],
    /// The elements that may be in it.
    pub(crate) inside: &'static [&'static str],
}

pub(crate) const MIN: [&str; 3] = ["MinX", "MinY", "MinZ"];
pub(crate) const MAX: [&str; 3] = ["MaxX", "MaxY", "MaxZ"];
pub(crate) const CENTER: [&str; 3] = ["CenterX", "CenterY", "CenterZ"];
pub(crate) const BRICK_SIZE: [&str; 3] = ["BrickXSize", "BrickYSize", "BrickZSize"];
pub(crate) const ORIGIN: [&str; 3] = ["X", "Y", "Z"];
pub(crate) const DELTA: [&str; 3] = ["DeltaX", "DeltaY", "DeltaZ"];
pub(crate) const VOLUME: [&str; 3] = ["VolumeXSize", "VolumeYSize", "VolumeZSize"];
pub(crate) const SURFACE: [[&str; 3]; 2] = [
    ["SurfaceMinX", "SurfaceMinY", "SurfaceMinZ"],
    ["SurfaceMaxX", "SurfaceMaxY", "SurfaceMaxZ"],
];

const fn word(name: &'static str, needed: bool, example: &'static str) -> Word {
    Word {
        name,
        needed,
        example,
    }
}

const fn three(names: [&'static str; 3], needed: bool, example: &'static str) -> [Word; 3] {
    let [x, y, z] = names;
    [
        word(x, needed, example),
        word(y, needed, example),
        word(z, needed, example),
    ]
}

const SIZES: &[Word] = &three(BRICK_SIZE, false, "8");
const BOX: [&[Word]; 2] = [&three(MIN, false, "0"), &three(MAX, false, "32")];
const COMPRESSED: &[Word] = &[word("Compressed", false, "NO")];
const OUTERMOST: &[Word] = &[word("Version", false, "1"), word("Crs", false, "EPSG:25832")];
const SPHERE: [&[Word]; 2] = [
    &three(CENTER, true, "16"),
    &[
        word("Radius", true, "27.72"),
        word("TreeFile", true, "trees/a.oct"),
    ],
];
const IN_GROUP: &[&str] = &["OctTreeGroup", "PagedOctTree", "CoarseOctTree"];

/// The outermost group of a scene.
pub(crate) const ROOT: Kind = Kind {
    name: "OctTreeGroup",
    attributes: &[OUTERMOST, COMPRESSED, SIZES, BOX[0], BOX[1]],
    inside: IN_GROUP,
};
/// A group inside another one.
pub(crate) const GROUP: Kind = Kind {
    name: "OctTreeGroup",
    attributes: &[COMPRESSED, SIZES, BOX[0], BOX[1]],
    inside: IN_GROUP,
};
/// A tree.
pub(crate) const TREE: Kind = Kind {
    name: "PagedOctTree",
    attributes: &[SPHERE[0], SPHERE[1], BOX[0], BOX[1]],
    inside: &[],
};
/// A tree that stands for its group.
pub(crate) const COARSE: Kind = Kind {
    name: "CoarseOctTree",
    attributes: &[
        SPHERE[0],
        SPHERE[1],
        &[word("Voxel", true, "0.5")],
        BOX[0],
        BOX[1],
    ],
    inside: &[],
};
/// What a scene consists of.
pub(crate) const SCENE: [&Kind; 4] = [&ROOT, &GROUP, &TREE, &COARSE];

/// An octree.
pub(crate) const OCTREE: Kind = Kind {
    name: "GigaVoxelsOctTree",
    attributes: &[
        &[word("Version", false, "1")],
        &three(ORIGIN, true, "0"),
        &three(DELTA, true, "0.5"),
        &three(VOLUME, true, "32"),
        &three(BRICK_SIZE, true, "8"),
        &[
            word("Binary", true, "NO"),
            word("Layout", false, "CENTRE"),
            word("Gain", false, "1"),
            word("SurfaceVoxels", false, "0"),
        ],
        &three(SURFACE[0], false, "0"),
        &three(SURFACE[1], false, "0"),
    ],
    inside: &["Node"],
};
/// A node of an octree.
pub(crate) const NODE: Kind = Kind {
    name: "Node",
    attributes: &[&[
        word("Type", true, "LEAF-CONST"),
        word("Brick", false, "0"),
        word("Color", false, "#6a9e4aff"),
    ]],
    inside: &["Node"],
};
/// What an octree consists of.
pub(crate) const TREE_FILE: [&Kind; 2] = [&OCTREE, &NODE];

impl Kind {
    /// Its attributes.
    pub(crate) fn words(&self) -> impl Iterator<Item = &'static Word> {
        self.attributes.iter().copied().flatten()
    }

    /// What was meant by an attribute that this element does not have.
    pub(crate) fn meant(&self, unknown: &str) -> Option<&'static str> {
        nearest(unknown, self.words().map(|w| w.name))
    }

    /// What to say about an attribute that this element does not have.
    pub(crate) fn about(&self, unknown: &str) -> String {
        let has = |kind: &&&Kind| kind.words().any(|w| w.name == unknown);
        if let Some(other) = SCENE.iter().chain(&TREE_FILE).find(has) {
            let which = if other.name == self.name {
                "the outermost"
            } else {
                "a"
            };
            return format!("it belongs to {which} {}", other.name);
        }
        match self.meant(unknown) {
            Some(name) => format!("did you mean {name}?"),
            None => {
                let known: Vec<&str> = self.words().map(|w| w.name).collect();
                format!("known: {}", known.join(", "))
            }
        }
    }

    /// What to say about an element that may not be in this one.
    pub(crate) fn about_inside(&self, unknown: &str) -> String {
        match nearest(unknown, self.inside.iter().copied()) {
            Some(name) => format!("did you mean {name}?"),
            None if self.inside.is_empty() => format!("end it with />, and write {unknown} beside it"),
            None => format!("known: {}", self.inside.join(", ")),
        }
    }
}

/// How an attribute may be written, for who left it out or wrote a value that cannot be.
pub(crate) fn example(name: &str) -> Option<String> {
    let kinds = SCENE.iter().chain(&TREE_FILE);
    let word = kinds.flat_map(|kind| kind.words()).find(|w| w.name == name)?;
    Some(format!("for instance {name}=\"{}\"", word.example))
}

/// Longest words that are compared, in characters.
const MAX_WORD: usize = 256;

/// The known word that a misspelt one is nearest to, if it is near: capitals apart, at most a third of its letters may be added, left
/// out, changed or swapped with the next (the optimal string alignment distance). Of equally near ones the first.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let letters = |text: &str| -> Vec<char> { text.to_lowercase().chars().take(MAX_WORD).collect() };
    let word = letters(word);
    let most = (word.len() / 3).max(1);
    known
        .into_iter()
        .map(|k| (distance(&word, &letters(k)), k))
        .filter(|(distance, known)| *distance <= most && *distance < known.chars().count())
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, known)| known)
}

fn distance(a: &[char], b: &[char]) -> usize {
    let mut rows: Vec<Vec<usize>> = vec![(0..=b.len()).collect()];
    for (i, x) in a.iter().enumerate() {
        let mut row = vec![i + 1];
        for (j, y) in b.iter().enumerate() {
            let change = rows[i][j] + usize::from(x != y);
            let mut least = change.min(rows[i][j + 1] + 1).min(row[j] + 1);
            if i > 0 && j > 0 && (*x, a[i - 1]) == (b[j - 1], *y) {
                least = least.min(rows[i - 1][j - 1] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests;

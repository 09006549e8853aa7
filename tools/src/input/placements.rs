//! Placements: a list of models and where each stands in the world, for vegetation and buildings.
//!
//! A text file, one placement a line: `model, x, y, z, heading, scale`. The model is an OBJ file beside the list; x and y are
//! world metres; z is world metres, too, or `ground`, with a height above it if there is one (`ground+0.5`). Heading, in degrees
//! clockwise from north, and scale may be left out. Blank lines and what follows `#` count for nothing.

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::error::InputError;
use super::mesh::Face;

/// Longest list that is read.
const MAX_BYTES: u64 = 1 << 30;
/// Farthest place from the origin on an axis, metres, and largest scale.
const MAX_METRES: f64 = 1e9;

/// Where a placed model stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Elevation {
    /// World metres.
    At(f64),
    /// Metres above the ground.
    AboveGround(f64),
}

/// A model in the world: scaled, turned, moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Line of the list, from 1.
    pub line: usize,
    /// World metres.
    pub x: f64,
    /// World metres.
    pub y: f64,
    /// Height of the model's origin.
    pub z: Elevation,
    /// Degrees clockwise from north.
    pub heading: f64,
    /// Factor of all lengths, above 0.
    pub scale: f64,
}

/// A model and all its placements in a list.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedModel {
    /// The OBJ file.
    pub path: PathBuf,
    /// In the order of the list.
    pub placements: Vec<Placement>,
}

/// Reads a list: models in the order in which they are first named.
///
/// # Errors
/// A file that cannot be read, a line that is not a placement.
pub fn read(list: &Path) -> Result<Vec<PlacedModel>, InputError> {
    let io = |e| InputError::io(list, e);
    let bytes = fs::metadata(list).map_err(io)?.len();
    if bytes > MAX_BYTES {
        return Err(InputError::unsupported(
            list,
            format!("a list of {bytes} bytes; the limit is {MAX_BYTES}"),
        ));
    }
    let text = fs::read_to_string(list).map_err(io)?;
    let folder = list.parent().unwrap_or(Path::new(""));
    let mut models: Vec<PlacedModel> = Vec::new();
    let mut numbers = std::collections::HashMap::new();
    for (line, text) in (1..).zip(text.lines()) {
        let text = text.split('#').next().unwrap_or_default().trim();
        if text.is_empty() {
            continue;
        }
        let (model, placement) = parse(text, line).map_err(|what| InputError::line(list, line, what))?;
        let number = *numbers.entry(model.to_string()).or_insert_with(|| {
            models.push(PlacedModel {
                path: folder.join(model),
                placements: Vec::new(),
            });
            models.len() - 1
        });
        models[number].placements.push(placement);
    }
    Ok(models)
}

fn parse(text: &str, line: usize) -> Result<(&str, Placement), String> {
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    let (model, x, y, z, rest) = match fields[..] {
        [model, x, y, z, ref rest @ ..] if rest.len() <= 2 && !model.is_empty() => (model, x, y, z, rest),
        _ => return Err("a placement is 'model, x, y, z, heading, scale'".into()),
    };
    let number = |name: &str, text: &str| match text.parse::<f64>() {
        Ok(v) if v.abs() <= MAX_METRES => Ok(v),
        _ => Err(format!("{name} '{text}' is not a number within ±{MAX_METRES}")),
    };
    let z = match z.strip_prefix("ground") {
        None => Elevation::At(number("z", z)?),
        Some("") => Elevation::AboveGround(0.0),
        Some(above) => Elevation::AboveGround(number("height above ground", above.trim())?),
    };
    let scale = rest.get(1).map_or(Ok(1.0), |s| number("scale", s))?;
    if scale <= 0.0 {
        return Err(format!("scale {scale} is not above 0"));
    }
    let placement = Placement {
        line,
        x: number("x", x)?,
        y: number("y", y)?,
        z,
        heading: rest.first().map_or(Ok(0.0), |h| number("heading", h))?,
        scale,
    };
    Ok((model, placement))
}

/// From a model's coordinates to the world's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    turn: DMat3,
    scale: f64,
    origin: DVec3,
}

impl Placement {
    /// Where it puts a model. `ground` gives the height of the ground at a place, if there is any.
    ///
    /// # Errors
    /// A model that is to stand on ground where there is none; whatever `ground` fails with.
    pub fn pose(
        &self,
        list: &Path,
        ground: impl FnOnce(f64, f64) -> Result<Option<f64>, InputError>,
    ) -> Result<Pose, InputError> {
        let z = match self.z {
            Elevation::At(z) => z,
            Elevation::AboveGround(above) => {
                let what = || {
                    let what = format!("there is no ground at {}, {}", self.x, self.y);
                    InputError::line(list, self.line, what)
                };
                ground(self.x, self.y)?.ok_or_else(what)? + above
            }
        };
        Ok(Pose {
            turn: DMat3::from_rotation_z(-self.heading.to_radians()),
            scale: self.scale,
            origin: DVec3::new(self.x, self.y, z),
        })
    }
}

impl Pose {
    /// A position of the model in the world.
    pub fn position(&self, p: DVec3) -> DVec3 {
        self.turn * (p * self.scale) + self.origin
    }

    /// A direction of the model in the world, as long as before.
    pub fn direction(&self, d: DVec3) -> DVec3 {
        self.turn * d
    }

    /// A face of the model in the world.
    pub fn face(&self, face: &Face) -> Face {
        let mut placed = *face;
        placed.corners = face.corners.map(|p| self.position(p));
        let normals = &mut placed.at.normals;
        *normals = normals.map(|n| n.map(|n| self.direction(n.as_dvec3()).as_vec3()));
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(text: &str) -> Result<Vec<PlacedModel>, InputError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("list.csv");
        fs::write(&path, text).unwrap();
        read(&path)
    }

    #[test]
    fn models_are_grouped_and_defaults_filled_in() {
        let models = list(
            "# model, x, y, z\noak tree.obj, 1, 2, ground\n\nsub/house.obj, -1.5, 2e1, 7, 90 # turned\n\
             oak tree.obj, 3, 4, ground-0.25, 0, 2\n",
        )
        .unwrap();
        let names: Vec<_> = models
            .iter()
            .map(|m| m.path.file_name().unwrap().to_str().unwrap())
            .collect();
        assert_eq!(names, ["oak tree.obj", "house.obj"]);
        let oaks = &models[0].placements;
        assert_eq!((oaks[0].z, oaks[0].scale), (Elevation::AboveGround(0.0), 1.0));
        assert_eq!((oaks[1].z, oaks[1].scale), (Elevation::AboveGround(-0.25), 2.0));
        let house = models[1].placements[0];
        assert_eq!((house.line, house.y, house.heading), (4, 20.0, 90.0));
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, what) in [
            ("a.obj, 1, 2", "is 'model, x"),
            ("a.obj, 1, 2, 3, 4, 5, 6", "is 'model, x"),
            (", 1, 2, 3", "is 'model, x"),
            ("a.obj, one, 2, 3", "x 'one'"),
            ("a.obj, 1, nan, 3", "y 'nan'"),
            ("a.obj, 1, 2, inf", "z 'inf'"),
            ("a.obj, 1, 2, ground+x", "above ground"),
            ("a.obj, 1, 2, 3, 0, 0", "scale 0"),
            ("a.obj, 1, 2, 3, 0, -1", "scale -1"),
        ] {
            let error = list(&format!("a.obj, 0, 0, 0\n{text}\n"))
                .unwrap_err()
                .to_string();
            assert!(error.contains("line 2") && error.contains(what), "{error}");
        }
    }

    #[test]
    fn a_pose_scales_turns_and_moves() {
        let placement = list("a.obj, 10, 20, ground+1, 90, 2").unwrap()[0].placements[0];
        let pose = placement.pose(Path::new("l"), |_, _| Ok(Some(5.0))).unwrap();
        // What the model has in the north lies in the east.
        assert!(pose.position(DVec3::Y).distance(DVec3::new(12.0, 20.0, 6.0)) < 1e-12);
        assert!(pose.direction(DVec3::X).distance(DVec3::NEG_Y) < 1e-12);
        let error = placement.pose(Path::new("l"), |_, _| Ok(None)).unwrap_err();
        assert!(error.to_string().contains("no ground at 10, 20"), "{error}");
    }
}

//! Scene configurations: room, table, light, camera ring and clutter, read from `scenes.json`.
//!
//! Lengths are metres, angles degrees, colours 8-bit sRGB. The world's origin is on
//! the floor in the middle of the room, z up.

mod checks;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::catalogue::Split;

/// Version of `scenes.json` that this build reads.
pub const SCENES_SCHEMA_VERSION: u32 = 2;

/// Why a scene configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigurationError {
    /// The file could not be read.
    #[error("cannot read scenes file {path}: {source}")]
    Io {
        /// File name.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not JSON of the expected form.
    #[error("{path} is not a scenes file: {source}")]
    Json {
        /// File name.
        path: String,
        /// Line, column and what was expected.
        source: serde_json::Error,
    },
    /// The file has another version.
    #[error("{path} has scenes schema version {found}, expected {SCENES_SCHEMA_VERSION}")]
    Version {
        /// File name.
        path: String,
        /// Version found.
        found: u32,
    },
    /// A value is out of its range.
    #[error("scene `{scene}`: {field} must be {expected}, found {found}")]
    Range {
        /// Scene name.
        scene: String,
        /// Field as written in the file.
        field: String,
        /// Value found.
        found: String,
        /// What is allowed.
        expected: String,
    },
    /// Two scenes share a name.
    #[error("scene `{0}` is defined twice")]
    Duplicate(String),
    /// No scene has this name.
    #[error("unknown scene `{name}`; known scenes: {}", known.join(", "))]
    Unknown {
        /// Name asked for.
        name: String,
        /// Names that exist.
        known: Vec<String>,
    },
}

/// What a surface is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceKind {
    /// Planks with grain, knots and pores.
    Wood,
    /// Polished stone: crystals, clouds and veins.
    Stone,
    /// Square tiles with grout, each clouded differently.
    Tiles,
    /// Running bond of bricks.
    Brick,
    /// Rolled paint over plaster, with stains and cracks.
    Plaster,
    /// Printed paper: jittered diamonds and sprigs.
    Wallpaper,
    /// Cast concrete: pits and stains.
    Concrete,
    /// Woven cloth with blotches.
    Cloth,
    /// Plain laminate: almost nothing to hold on to.
    Laminate,
    /// Chips of stone in two colours in a pale ground.
    Terrazzo,
    /// Strips of bamboo, glued, with their nodes.
    Bamboo,
    /// Riven slate slabs with rusty stains.
    Slate,
    /// Woven cloth in squares of two colours.
    Checkered,
}

/// A procedural surface; the same values give the same texels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Material family.
    pub kind: SurfaceKind,
    /// Main colour, sRGB.
    pub base: [u8; 3],
    /// Second colour (veins, grout, grain), sRGB.
    pub accent: [u8; 3],
    /// Strength of everything that is not the main colour, in [0, 1.5].
    pub contrast: f32,
    /// Density of scratches, speckle and stains, in [0, 1].
    pub wear: f32,
    /// Size of a feature relative to its natural size, in [0.3, 4].
    pub scale: f32,
    /// Perceptual roughness, in [0.05, 1].
    pub roughness: f32,
    /// Texels along the longer side, in [64, 4096].
    pub texels: u32,
    /// Seed of the pattern.
    pub seed: u64,
}

/// Room: four walls around the origin, a floor, and things along the walls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Room {
    /// Extent along x, y and z, metres.
    pub size_m: [f32; 3],
    /// Floor.
    pub floor: Surface,
    /// Walls; each wall has a seed of its own derived from this one.
    pub wall: Surface,
    /// Furniture (cupboards, frames, shelves).
    pub wood: Surface,
    /// Seed of what stands and hangs along the walls.
    pub decor_seed: u64,
    /// Share of the wall slots that are filled, in [0, 1].
    pub decor_density: f32,
}

/// Outline of a table top.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TableShape {
    /// A rectangle.
    Rectangle,
    /// An ellipse.
    Round,
}

/// Table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Outline.
    pub shape: TableShape,
    /// Extent of the top along x and y, metres.
    pub size_m: [f32; 2],
    /// Height of the top's upper face above the floor, metres.
    pub height_m: f32,
    /// Where the middle of the top is, x and y, metres.
    pub center_m: [f32; 2],
    /// The top.
    pub top: Surface,
    /// Apron and legs.
    pub frame: Surface,
}

/// A bright patch of the surroundings: a window or a pale wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Glow {
    /// Direction towards it; need not have unit length.
    pub direction: [f32; 3],
    /// Linear radiance at its middle.
    pub color: [f32; 3],
    /// Falloff, in [1, 200]: 4 is broad, 60 a window.
    pub sharpness: f32,
}

/// Light: a spherical key light and the surroundings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lighting {
    /// Middle of the key light, metres; above the table and inside the room.
    pub position_m: [f32; 3],
    /// Radius of the key light, metres: the larger, the softer the shadows.
    pub radius_m: f32,
    /// Linear irradiance over π of the key light at one metre.
    pub intensity: [f32; 3],
    /// Linear ambient radiance from above.
    pub sky: [f32; 3],
    /// Linear ambient radiance from below.
    pub ground: [f32; 3],
    /// Bright patches.
    pub glows: Vec<Glow>,
    /// Factor before the tone curve, in [0.2, 4].
    pub exposure: f32,
}

/// Ellipse that the camera moves along.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ellipse {
    /// Middle, x and y, metres.
    pub center_m: [f64; 2],
    /// Semi-axes along x and y, metres, each in [0.5, 0.85].
    pub semi_axes_m: [f64; 2],
    /// Height of the camera above the floor, metres, in [1.4, 1.6].
    pub camera_height_m: f64,
}

/// How things on a table relate to one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClutterStyle {
    /// Each by itself on the table, well apart.
    Sparse,
    /// Close together on the table.
    Packed,
    /// Plates, bowls, books and trays in stacks that carry things.
    Stacked,
    /// Long things lean against what stands.
    Leaning,
    /// Long things stand in mugs, pitchers and measuring cups.
    InContainers,
    /// Things stand on a tray.
    OnTray,
}

/// How things lie on the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clutter {
    /// How things relate to one another.
    pub style: ClutterStyle,
    /// Semi-axes of the ellipse around the table's middle that holds the objects' centres, metres.
    pub extent_m: [f32; 2],
    /// 0 spreads evenly, 1 heaps around the target.
    pub tightness: f32,
    /// Smallest and largest number of distractors.
    pub distractors: [u32; 2],
    /// Smallest gap between two objects' footprints, metres, at least 0.002.
    pub gap_m: f32,
}

/// A scene without its objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneConfiguration {
    /// Unique name, prefixed by its split.
    pub name: String,
    /// Split.
    pub split: Split,
    /// One line for people.
    pub description: String,
    /// Whether the table is made hard to register on purpose; such scenes are left out of
    /// episode sets.
    #[serde(default)]
    pub weak_texture: bool,
    /// Room.
    pub room: Room,
    /// Table.
    pub table: Table,
    /// Light.
    pub light: Lighting,
    /// Camera path.
    pub ellipse: Ellipse,
    /// Style of the clutter.
    pub clutter: Clutter,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenesFile {
    schema_version: u32,
    scenes: Vec<SceneConfiguration>,
}

/// Reads and checks every scene of a `scenes.json`.
pub fn load(path: &Path) -> Result<Vec<SceneConfiguration>, ConfigurationError> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|source| ConfigurationError::Io { path: name.clone(), source })?;
    parse(&name, &text)
}

/// Reads and checks the text of a `scenes.json`; `path` is for messages.
pub fn parse(path: &str, text: &str) -> Result<Vec<SceneConfiguration>, ConfigurationError> {
    let file: ScenesFile =
        serde_json::from_str(text).map_err(|source| ConfigurationError::Json { path: path.to_owned(), source })?;
    if file.schema_version != SCENES_SCHEMA_VERSION {
        return Err(ConfigurationError::Version { path: path.to_owned(), found: file.schema_version });
    }
    for (i, scene) in file.scenes.iter().enumerate() {
        scene.validate()?;
        if file.scenes[..i].iter().any(|s| s.name == scene.name) {
            return Err(ConfigurationError::Duplicate(scene.name.clone()));
        }
    }
    Ok(file.scenes)
}

/// The scene called `name`.
pub fn find<'a>(scenes: &'a [SceneConfiguration], name: &str) -> Result<&'a SceneConfiguration, ConfigurationError> {
    scenes.iter().find(|s| s.name == name).ok_or_else(|| ConfigurationError::Unknown {
        name: name.to_owned(),
        known: scenes.iter().map(|s| s.name.clone()).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHIPPED: &str = include_str!("../../../python/fuse_grounding/data/scenes.json");

    #[test]
    fn shipped_scenes_are_sound() {
        let scenes = parse("scenes.json", SHIPPED).unwrap();
        let used: Vec<_> = scenes.iter().filter(|s| !s.weak_texture).collect();
        let of = |split| used.iter().filter(|s| s.split == split).count();
        assert_eq!(Split::ALL.map(of), [2, 1, 6]);
        let styles: std::collections::HashSet<_> = used.iter().map(|s| s.clutter.style).collect();
        assert_eq!(styles.len(), 6, "a clutter style has no scene");
        assert!(scenes.iter().any(|s| s.weak_texture));
        assert!(find(&scenes, "dev_kitchn").unwrap_err().to_string().contains("dev_kitchen"));
    }

    #[test]
    fn mistakes_are_named() {
        let typo = SHIPPED.replacen("\"tightness\"", "\"tightnes\"", 1);
        assert!(parse("s.json", &typo).unwrap_err().to_string().contains("tightnes"));
        let version = SHIPPED.replacen("\"schema_version\": 2", "\"schema_version\": 9", 1);
        assert!(parse("s.json", &version).unwrap_err().to_string().contains("version 9, expected 2"));

        let mut scene = parse("s.json", SHIPPED).unwrap().remove(0);
        scene.ellipse.semi_axes_m[1] = 1.4;
        let message = scene.validate().unwrap_err().to_string();
        assert!(message.contains("ellipse.semi_axes_m.y must be in [0.5, 0.85], found 1.4"), "{message}");
        scene.ellipse.semi_axes_m[1] = f64::NAN;
        assert!(scene.validate().is_err());
    }
}

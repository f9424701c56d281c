//! A user's model file as an object: turned, scaled, checked, measured, laid to rest.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use fuse_render::{Model, ModelError};
use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::catalogue::{Category, ObjectRecord, Split};
use crate::objects::measure::{self, Measures};
use crate::objects::resting;

pub use crate::objects::measure::MassFrom;

/// What the import of a model file found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Imported {
    /// The file's name, without folders.
    pub source: String,
    /// Metres of one unit of the file.
    pub metres_per_unit: f64,
    /// The file's axis that points up.
    pub up: Up,
    /// Triangles.
    pub triangles: usize,
    /// Whether every edge is shared by triangles that agree about the outside.
    pub closed: bool,
    /// Enclosed volume where closed, else that of the convex hull, cubic metres.
    pub volume_m3: f64,
    /// Rough estimate from the volume, kilograms.
    pub mass_kg: f64,
    /// What the centre of mass, and with it the resting poses, were computed from.
    pub mass_from: MassFrom,
    /// What a person should look at.
    pub warnings: Vec<String>,
}

/// A file's axis that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// As glTF has it.
    Y,
    /// As this project has it.
    Z,
}

impl FromStr for Up {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "y" => Ok(Self::Y),
            "z" => Ok(Self::Z),
            _ => Err(format!("unknown axis `{name}`, expected y or z")),
        }
    }
}

impl fmt::Display for Up {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if *self == Self::Y { "y" } else { "z" })
    }
}

/// What a user says about a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// What the thing is.
    pub category: Category,
    /// What it may be used for.
    pub split: Split,
    /// Metres of one unit of the file.
    pub metres_per_unit: f64,
    /// The file's axis that points up; `None`: y for glTF, z for OBJ.
    pub up: Option<Up>,
    /// The object's name; `None`: from the file's.
    pub id: Option<String>,
}

/// A model ready to be put into a library, see [`crate::library::add`].
#[derive(Clone, Debug)]
pub struct Import {
    /// What the catalogue will say of it.
    pub record: ObjectRecord,
    /// The model, metres, z up, its footprint's centre on the origin, its lowest point at z = 0.
    pub model: Model,
}

/// Why a file does not become an object.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The model file.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Its size.
    #[error("{path}: its longest side is {}, expected {} to {} for a thing on a table{hint}",
        length(*found), length(SMALLEST), length(LARGEST))]
    Size {
        /// File name.
        path: String,
        /// Longest side with the scale asked for, metres.
        found: f64,
        /// What may be meant.
        hint: String,
    },
    /// A scale that is no scale.
    #[error("a scale must be finite and greater than 0, found {0}")]
    Scale(f64),
    /// A name that cannot be an object's.
    #[error("{path}: `{id}` cannot name an object: {reason}")]
    Id {
        /// File name.
        path: String,
        /// The name.
        id: String,
        /// What is wrong with it.
        reason: &'static str,
    },
}

/// Longest side of a thing that is taken, metres: from a thumbtack …
const SMALLEST: f64 = 0.005;
/// … to a broom.
const LARGEST: f64 = 2.0;
/// Triangles above which episodes are noticeably slower.
const MANY_TRIANGLES: usize = 200_000;
/// Longest name of an object.
const LONGEST_ID: usize = 80;
/// Units that files are commonly in: name, metres.
const UNITS: [(&str, f64); 4] = [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)];

/// Metres of a unit's name.
///
/// # Errors
/// The known names, in words.
pub fn unit(name: &str) -> Result<f64, String> {
    let known = UNITS.iter().find(|u| u.0 == name);
    known.map(|u| u.1).ok_or_else(|| format!("unknown unit `{name}`, expected one of: m, cm, mm, in"))
}

/// Reads a model file and makes an object of it. Nothing is written.
///
/// # Errors
/// [`ImportError`] naming the file and what is wrong with it.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Import, ImportError> {
    let name = path.display().to_string();
    let scale = options.metres_per_unit;
    if !(scale.is_finite() && scale > 0.0) {
        return Err(ImportError::Scale(scale));
    }
    let id = id_of(path, options).map_err(|(id, reason)| ImportError::Id { path: name.clone(), id, reason })?;
    let (mut model, mut warnings) = fuse_render::load_noted(path)?;
    let stands = if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj")) { Up::Z } else { Up::Y };
    let up = options.up.unwrap_or(stands);
    place(&mut model, scale, stands, up);
    let size = extent(&model);
    let longest = f64::from(size.max_element());
    if !(SMALLEST..=LARGEST).contains(&longest) {
        return Err(ImportError::Size { path: name, found: longest, hint: hint(longest, scale, options.category) });
    }
    model.check().map_err(|reason| ModelError::Invalid { path: name, reason })?;
    let Measures { closed, open_edges, volume, mass, centre, mass_from } = measure::measure(&model);
    warnings.extend(concerns(&model, longest, options.category));
    if mass_from == MassFrom::Hull {
        let why = if closed { "it encloses no volume".into() } else { format!("it is open ({open_edges} edges)") };
        warnings.push(format!("{why}: mass, centre of mass and resting poses are those of its convex hull"));
    }
    // People put a mug on its bottom; of things that the shipped set does not have, nothing is known.
    let natural = (!options.category.is_own()).then(|| options.category.natural_share());
    let resting = resting::foreign_poses(&model, centre, natural);
    let source = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let imported = Imported {
        source,
        metres_per_unit: scale,
        up,
        triangles: model.triangle_count(),
        closed,
        volume_m3: volume,
        mass_kg: mass,
        mass_from,
        warnings,
    };
    let record = ObjectRecord {
        file: format!("{id}.glb"),
        id,
        category: options.category,
        split: options.split,
        size_m: size.to_array(),
        resting,
        seed: None,
        imported: Some(imported),
    };
    Ok(Import { record, model })
}

/// A name from the file's, or the one asked for.
fn id_of(path: &Path, options: &ImportOptions) -> Result<String, (String, &'static str)> {
    let stem = path.file_stem().map(|s| s.to_string_lossy().to_lowercase()).unwrap_or_default();
    let made: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let id = options.id.clone().unwrap_or_else(|| made.trim_matches('_').to_owned());
    let reason = if id.is_empty() || id.len() > LONGEST_ID {
        "expected 1 to 80 characters"
    } else if !id.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_' || b == b'-') {
        "expected lower-case letters, digits, `_` and `-`"
    } else if is_shipped_name(&id) {
        "the shipped set has objects named so; give another"
    } else {
        return Ok(id);
    };
    Err((id, reason))
}

/// Whether an id is of the form `mug_eval_1`.
fn is_shipped_name(id: &str) -> bool {
    Category::ALL.iter().any(|c| {
        let rest = id.strip_prefix(c.id()).and_then(|r| r.strip_prefix('_'));
        let number = |s: &Split| rest.and_then(|r| r.strip_prefix(s.id())).and_then(|r| r.strip_prefix('_'));
        Split::ALL.iter().filter_map(number).any(|n| n.parse::<u64>().is_ok())
    })
}

/// Turns a model that was read with `stands` up into one with `up`, scales it, and puts its
/// footprint's centre on the origin and its lowest point at z = 0.
fn place(model: &mut Model, scale: f64, stands: Up, up: Up) {
    let turn = |v: Vec3| match (stands, up) {
        (Up::Y, Up::Z) => Vec3::new(v.x, v.z, -v.y),
        (Up::Z, Up::Y) => Vec3::new(v.x, -v.z, v.y),
        _ => v,
    };
    for mesh in &mut model.meshes {
        mesh.positions.iter_mut().for_each(|p| *p = (turn(*p).as_dvec3() * scale).as_vec3());
        mesh.normals.iter_mut().for_each(|n| *n = turn(*n));
    }
    let Some((low, high)) = model.bounds() else { return };
    let shift = Vec3::new((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, low.z);
    model.meshes.iter_mut().flat_map(|m| &mut m.positions).for_each(|p| *p -= shift);
}

fn extent(model: &Model) -> Vec3 {
    // A sheet has no thickness, but sizes are positive.
    model.bounds().map_or(Vec3::ZERO, |(low, high)| (high - low).max(Vec3::splat(1e-6)))
}

/// What a wrong size may mean.
fn hint(longest: f64, scale: f64, category: Category) -> String {
    let [low, high] = typical(category).unwrap_or([0.03, 0.5]);
    let off = |l: f64| (l / (low * high).sqrt()).ln().abs();
    let likely = UNITS
        .iter()
        .map(|&(name, metres)| (name, longest / scale * metres))
        .filter(|u| (SMALLEST..=LARGEST).contains(&u.1))
        .min_by(|a, b| off(a.1).total_cmp(&off(b.1)));
    match likely {
        Some((name, l)) => format!("; did you mean --unit {name} ({})?", length(l)),
        None if longest > 0.0 && longest.is_finite() => {
            format!("; no common unit fits, --scale {:.3e} would make it {}", scale * 0.15 / longest, length(0.15))
        }
        None => String::new(),
    }
}

/// What is unusual about a thing that is taken.
fn concerns(model: &Model, longest: f64, category: Category) -> Vec<String> {
    let mut out = vec![];
    if let Some([low, high]) = typical(category)
        && !(low..=high).contains(&longest)
    {
        let (l, a, b) = (length(longest), length(low), length(high));
        out.push(format!("its longest side is {l}, that of a {} usually {a} to {b}: check the unit", category.label()));
    }
    if model.triangle_count() > MANY_TRIANGLES {
        out.push(format!("{} triangles make episodes slow; {MANY_TRIANGLES} are plenty", model.triangle_count()));
    }
    out
}

/// A length as people say it.
fn length(metres: f64) -> String {
    let round = |v: f64| {
        let digits = (2 - v.abs().max(1e-9).log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{v:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    };
    match metres {
        m if m < 0.01 => format!("{} mm", round(m * 1e3)),
        m if m < 1.0 => format!("{} cm", round(m * 1e2)),
        m if m < 1e4 => format!("{} m", round(m)),
        m => format!("{m:.1e} m"),
    }
}

/// Longest side of most things of a shipped category, metres; wider than the generated ones.
pub fn typical(category: Category) -> Option<[f64; 2]> {
    use Category as C;
    Some(match category {
        C::Knife => [0.12, 0.45],
        C::Ladle => [0.18, 0.45],
        C::RollingPin => [0.2, 0.6],
        C::Tray => [0.15, 0.6],
        C::Scissors | C::ButterKnife | C::Spoon | C::Fork => [0.1, 0.32],
        C::Whisk | C::Spatula | C::Tongs | C::Sieve | C::Chopsticks => [0.13, 0.45],
        C::Mug | C::MeasuringCup => [0.06, 0.2],
        C::Bowl | C::Plate => [0.08, 0.4],
        C::Pitcher | C::Teapot | C::WaterBottle => [0.1, 0.4],
        C::Colander => [0.15, 0.45],
        C::WineGlass | C::Grater => [0.1, 0.32],
        C::Marker | C::Pen | C::Pencil => [0.08, 0.22],
        C::Ruler => [0.1, 0.65],
        C::Hammer | C::Mallet => [0.2, 0.5],
        C::Screwdriver | C::Wrench | C::Pliers => [0.08, 0.4],
        C::Flashlight | C::Stapler | C::TapeDispenser => [0.06, 0.3],
        C::BoxCutter | C::ScrubBrush => [0.08, 0.35],
        C::Sponge => [0.05, 0.2],
        C::Towel => [0.1, 0.8],
        C::Book => [0.1, 0.4],
        C::TapeMeasure | C::Can | C::Candle => [0.04, 0.25],
        C::Eraser | C::BinderClip => [0.015, 0.1],
        C::Other(_) => return None,
    })
}

#[cfg(test)]
mod tests;

//! The WGSL of every stage, composed: constants of the CPU's files, what stages share, the stage.
//!
//! Compiled without the feature `gpu` too, so that naga can validate the shaders where there is no
//! GPU stack at all.

use crate::cpu::raster::{LANES, SAMPLES};
use crate::cpu::shadow::baked;
use crate::cpu::{occlusion, resolve, shade, shadow, texture};

/// Most shadow maps: a fine one and a coarse one.
pub(crate) const SHADOW_MAPS: usize = 2;

/// A WGSL module.
#[derive(Debug)]
pub struct Stage {
    /// As the file.
    pub name: &'static str,
    /// Its entry points.
    pub entries: &'static [&'static str],
    sources: &'static [&'static str],
}

const COMMON: &str = include_str!("common.wgsl");
const GEOMETRY: &str = include_str!("geometry.wgsl");
const CENTERS: &str = include_str!("centers.wgsl");

/// `raster.wgsl`
pub const RASTER: Stage =
    Stage { name: "raster", entries: &["transform", "raster"], sources: &[COMMON, include_str!("raster.wgsl")] };
/// `centers.wgsl`
pub const RESOLVE_CENTERS: Stage =
    Stage { name: "centers", entries: &["centers"], sources: &[COMMON, GEOMETRY, CENTERS] };
/// `pixels.wgsl`
pub const RESOLVE_PIXELS: Stage = Stage {
    name: "pixels",
    entries: &["centers", "pixels"],
    sources: &[
        COMMON,
        GEOMETRY,
        CENTERS,
        include_str!("light.wgsl"),
        include_str!("texture.wgsl"),
        include_str!("shadow/baked.wgsl"),
        include_str!("shadow.wgsl"),
        include_str!("occlusion.wgsl"),
        include_str!("shade.wgsl"),
        include_str!("pixels.wgsl"),
    ],
};
/// `count.wgsl`
pub const COUNT: Stage = Stage { name: "count", entries: &["count"], sources: &[include_str!("count.wgsl")] };

/// All of them.
pub const STAGES: [Stage; 4] = [RASTER, RESOLVE_CENTERS, RESOLVE_PIXELS, COUNT];

impl Stage {
    /// The whole module.
    pub fn source(&self) -> String {
        let mut source = constants();
        for part in self.sources {
            source.push_str(part);
        }
        source
    }
}

/// The CPU's constants in WGSL.
fn constants() -> String {
    let numbers = [
        ("ALIKE", resolve::ALIKE),
        ("NEARBY", resolve::NEARBY),
        ("MAX_TAPS", texture::MAX_TAPS),
        ("TAP_ASPECT", texture::ASPECT),
        ("TAP_STRETCH", texture::STRETCH),
        ("LEVEL_ALONE", texture::ALONE),
        ("TEXEL_ONE", texture::ONE),
        ("SHADOW_NEAREST", shadow::NEAREST),
        ("SHADOW_STEEPEST", shadow::STEEPEST),
        ("SHADOW_BIAS", shadow::BIAS),
        ("SHADOW_ON", baked::ON),
        ("SHADOW_STEPS", baked::STEPS),
        ("SHADOW_ENOUGH", baked::ENOUGH),
        ("MAX_DISC", shadow::MAX_DISC),
        ("OCCLUSION_GAIN", occlusion::GAIN),
        ("OCCLUSION_FADE", occlusion::FADE),
        ("TONE_START", shade::TONE_START),
        ("TONE_DESATURATION", shade::TONE_DESATURATION),
        ("SRGB_STEPS", (shade::SrgbTable::SIZE - 1) as f32),
    ];
    let counts = [
        ("LANES", LANES as u32),
        ("SHADOW_MAPS", SHADOW_MAPS as u32),
        ("TEXEL_SQUARE", texture::SQUARE),
        ("TEXEL_ROW", texture::ROW),
    ];
    let mut out = String::new();
    for (name, value) in counts {
        out.push_str(&format!("const {name}: u32 = {value}u;\n"));
    }
    for (name, value) in numbers {
        out.push_str(&format!("const {name}: f32 = {value:?}f;\n"));
    }
    let samples: Vec<String> = SAMPLES.iter().map(|[x, y]| format!("vec2f({x:?}, {y:?})")).collect();
    out.push_str(&format!("const SAMPLES = array<vec2f, {LANES}>({});\n", samples.join(", ")));
    out
}

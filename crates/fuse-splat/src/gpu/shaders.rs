//! The WGSL of every stage, composed: constants from `constants.rs`, what stages share, the stage.
//!
//! Compiled without the feature `gpu` too, so that naga can validate the shaders where there is no
//! GPU stack at all.

use crate::constants as c;
use crate::table::LANES;

// tile.wgsl and intersect.wgsl give a thread a block, a vec4 a row of it and a byte of the mask a row
// of blocks; loss.wgsl writes the window out.
const _: () = assert!(c::TILE_BLOCKS == 64 && c::TILE_WIDTH == 32 && c::BLOCK_WIDTH == 4 && c::BLOCK_HEIGHT == 2);
const _: () = assert!(c::SSIM_WINDOW == 11);

/// A WGSL module.
#[derive(Debug)]
pub struct Stage {
    /// As the file.
    pub name: &'static str,
    /// Its compute entry points.
    pub entries: &'static [&'static str],
    sources: &'static [&'static str],
}

const GEOMETRY: &str = include_str!("geometry.wgsl");
const SH: &str = include_str!("sh.wgsl");
const TILE: &str = include_str!("tile.wgsl");

macro_rules! stage {
    ($constant:ident, $name:literal, $entries:expr $(, $shared:expr)*) => {
        #[doc = concat!("`", $name, ".wgsl`")]
        pub const $constant: Stage = Stage {
            name: $name,
            entries: &$entries,
            sources: &[$($shared,)* include_str!(concat!($name, ".wgsl"))],
        };
    };
}
stage!(PROJECT, "project", ["project"], SH, GEOMETRY);
stage!(SCAN, "scan", ["scan"]);
stage!(SORT, "sort", ["depth_keys", "count", "scatter"]);
stage!(INTERSECT, "intersect", ["count", "emit", "ranges"]);
stage!(RASTERIZE, "rasterize", ["rasterize"], TILE);
stage!(LOSS, "loss", ["slopes", "gradient", "total"]);
stage!(RASTERIZE_BACKWARD, "rasterize_backward", ["rasterize_backward"], TILE);
stage!(PROJECT_BACKWARD, "project_backward", ["project_backward"], SH, GEOMETRY);
stage!(ADAM, "adam", ["adam"]);

/// All of them, in the order of an iteration.
pub const STAGES: [Stage; 9] =
    [PROJECT, SCAN, SORT, INTERSECT, RASTERIZE, LOSS, RASTERIZE_BACKWARD, PROJECT_BACKWARD, ADAM];

impl Stage {
    /// The whole module.
    pub fn source(&self) -> String {
        let mut source = constants();
        for part in std::iter::once(&include_str!("common.wgsl")).chain(self.sources) {
            source.push_str(part);
        }
        source
    }
}

/// `constants.rs` in WGSL.
fn constants() -> String {
    let counts = [
        ("PARAMETERS", c::PARAMETERS),
        ("LANES", LANES),
        ("POSITION", c::POSITION),
        ("SCALE", c::SCALE),
        ("ROTATION", c::ROTATION),
        ("OPACITY", c::OPACITY),
        ("DC", c::DC),
        ("REST", c::REST),
        ("REST_PER_CHANNEL", c::REST_PER_CHANNEL),
        ("TILE_WIDTH", c::TILE_WIDTH),
        ("TILE_HEIGHT", c::TILE_HEIGHT),
        ("BLOCK_WIDTH", c::BLOCK_WIDTH),
        ("BLOCK_HEIGHT", c::BLOCK_HEIGHT),
        ("TILE_BLOCKS", c::TILE_BLOCKS),
        ("SSIM_WINDOW", c::SSIM_WINDOW),
    ];
    let numbers = [
        ("NEAR", c::NEAR),
        ("FOV_MARGIN", c::FOV_MARGIN),
        ("ALPHA_MAX", c::ALPHA_MAX),
        ("LOG2_ALPHA_MIN", c::LOG2_ALPHA_MIN),
        ("TRANSMITTANCE_MIN", c::TRANSMITTANCE_MIN),
        ("SSIM_C1", c::SSIM_C1),
        ("SSIM_C2", c::SSIM_C2),
        ("BETA1", c::BETA1),
        ("BETA2", c::BETA2),
        ("ADAM_EPSILON", c::ADAM_EPSILON),
        ("SH_C0", c::SH_C0),
        ("LOG2_E", std::f32::consts::LOG2_E),
        ("LN_2", std::f32::consts::LN_2),
    ];
    let mut out = String::new();
    for (name, value) in counts {
        out.push_str(&format!("const {name}: u32 = {value}u;\n"));
    }
    for (name, value) in numbers {
        out.push_str(&format!("const {name}: f32 = {value:?}f;\n"));
    }
    for (distance, weight) in ssim_weights().into_iter().enumerate() {
        out.push_str(&format!("const W{distance}: f32 = {weight:?}f;\n"));
    }
    out
}

/// Half the SSIM window, from its centre; the whole adds up to one.
fn ssim_weights() -> [f32; c::SSIM_WINDOW / 2 + 1] {
    let weight = |d: usize| (-((d * d) as f64) / (2.0 * c::SSIM_SIGMA * c::SSIM_SIGMA)).exp();
    let sum: f64 = (0..c::SSIM_WINDOW).map(|i| weight(i.abs_diff(c::SSIM_WINDOW / 2))).sum();
    std::array::from_fn(|d| (weight(d) / sum) as f32)
}

//! Materials with their textures.

use std::f32::consts::TAU;

use fuse_render::Material;
use glam::{Vec2, Vec3};

use super::dice::Dice;
use super::table::{Stuff, finishes};
use super::texture::{Canvas, Noise};

/// A material from a texture; its `name` also stands for a density, see
/// [`density`].
pub fn material(name: &str, canvas: &Canvas, metallic: f32, roughness: f32) -> Material {
    Material {
        name: name.into(),
        base_color: [1.0; 4],
        base_color_texture: Some(canvas.texture()),
        metallic,
        roughness,
        double_sided: false,
    }
}

/// Density by material name, kg/m³; 1000 for what is not listed.
pub fn density(name: &str) -> f32 {
    match name {
        "steel" => 7800.0,
        "ceramic" => 2300.0,
        "rubber" => 1200.0,
        "wood" | "paper" => 700.0,
        "cloth" => 300.0,
        "foam" => 100.0,
        _ => 1000.0,
    }
}

/// Steel; the tile is meant for about 6 cm, scratches along v.
pub fn steel(dice: &mut Dice) -> Material {
    let family = dice.family(&finishes(Stuff::Steel));
    let noise = Noise(dice.seed());
    let level = dice.any(0.78, 0.90);
    let (tone, contrast, roughness) = match family {
        "brushed" => (Vec3::new(1.0, 1.0, 1.01), 0.12, 0.34),
        "satin" => (Vec3::new(1.0, 1.0, 1.0), 0.05, 0.40),
        "polished" => (Vec3::new(1.0, 1.01, 1.03), 0.03, 0.20),
        "dull" => (Vec3::new(0.86, 0.87, 0.88), 0.10, 0.55),
        "warm" => (Vec3::new(1.05, 1.0, 0.92), 0.08, 0.40),
        _ => (Vec3::new(0.98, 1.0, 1.02), 0.08, 0.30),
    };
    let canvas = Canvas::new(64, 64, Vec3::ZERO).each(|uv, _| {
        let scratch = if family == "hammered" {
            noise.spots(uv, (10, 10)).min(1.0)
        } else {
            0.6 * noise.smooth(uv, (64, 3)) + 0.4 * noise.cloud(uv, (3, 3))
        };
        tone * (level + contrast * (scratch - 0.5))
    });
    material("steel", &canvas, 0.85, roughness)
}

/// Steel a shade lighter, for ground edges: the same family is not needed at their size.
pub fn bright_steel(dice: &mut Dice) -> Material {
    let canvas = Canvas::new(4, 4, dice.tint(Vec3::splat(0.88), 0.03));
    material("steel", &canvas, 0.5, 0.3)
}

/// Wood; grain along v, one tile for about 8 cm by 16 cm.
pub fn wood(dice: &mut Dice) -> Material {
    let family = dice.family(&finishes(Stuff::Wood));
    let (light, dark, rings): (Vec3, Vec3, f32) = match family {
        "oak" => (Vec3::new(0.78, 0.60, 0.40), Vec3::new(0.58, 0.40, 0.23), 9.0),
        "walnut" => (Vec3::new(0.45, 0.29, 0.18), Vec3::new(0.27, 0.16, 0.09), 7.0),
        "beech" => (Vec3::new(0.87, 0.70, 0.50), Vec3::new(0.76, 0.56, 0.37), 12.0),
        "cherry" => (Vec3::new(0.66, 0.36, 0.21), Vec3::new(0.48, 0.22, 0.12), 8.0),
        "ash" => (Vec3::new(0.88, 0.80, 0.66), Vec3::new(0.66, 0.54, 0.38), 6.0),
        _ => (Vec3::new(0.62, 0.42, 0.20), Vec3::new(0.30, 0.18, 0.08), 10.0),
    };
    let (light, dark) = (dice.tint(light, 0.08), dice.tint(dark, 0.10));
    let noise = Noise(dice.seed());
    let canvas = Canvas::new(64, 128, light).each(|uv, _| {
        let wander = noise.cloud(uv, (2, 1)) * 2.2 + 0.25 * (TAU * uv.y).sin();
        let ring = 0.5 + 0.5 * (TAU * (uv.x * rings.round() + wander)).sin();
        let pore = noise.smooth(uv, (48, 6));
        let mix = (0.65 * ring * ring + 0.35 * pore).clamp(0.0, 1.0);
        light.lerp(dark, mix)
    });
    material("wood", &canvas, 0.0, 0.6)
}

/// Glazed ceramic: u around, v from rim (0) to foot (1).
pub fn ceramic(dice: &mut Dice) -> Material {
    let family = dice.family(&finishes(Stuff::Ceramic));
    let noise = Noise(dice.seed());
    let pale = dice.chance(0.45);
    let base = if pale { dice.color((0.02, 0.14), (0.82, 0.95)) } else { dice.color((0.35, 0.8), (0.35, 0.8)) };
    let accent = if pale { dice.vivid() } else { dice.color((0.03, 0.2), (0.8, 0.95)) };
    let clay = dice.tint(Vec3::new(0.72, 0.55, 0.40), 0.15);
    let (edge, width, count) = (dice.any(0.35, 0.75), dice.any(0.04, 0.12), dice.any(3.0, 6.0).floor());
    let canvas = Canvas::new(128, 128, base).each(|uv, _| {
        let color = match family {
            "speckled" if noise.spots(uv, (26, 22)) < 0.22 => accent * 0.5,
            "bands" if (uv.y * count).fract() < width * count && uv.y * count < count - 1.0 && uv.y > 0.06 => accent,
            "dipped" if uv.y > edge + 0.05 * (noise.smooth(uv, (7, 1)) - 0.5) => clay,
            "dots" if ((uv * Vec2::new(10.0, 6.0)).fract() - 0.5).length() < 0.27 => accent,
            "zigzag" => {
                let line = uv.y - edge * 0.8 + ((uv.x * 9.0).fract() - 0.5).abs() * 0.16;
                if line.abs() < 0.045 || (line - 0.16).abs() < 0.02 { accent } else { base }
            }
            "reactive" => base.lerp(accent, (1.6 * noise.cloud(uv, (4, 3)) + uv.y - 0.9).clamp(0.0, 1.0)),
            _ => base,
        };
        color * (0.97 + 0.06 * noise.cloud(uv, (5, 5)))
    });
    material("ceramic", &canvas, 0.0, 0.25)
}

/// A plain glaze in a colour, for insides and lids.
pub fn glaze(color: Vec3) -> Material {
    material("ceramic", &Canvas::new(4, 4, color), 0.0, 0.25)
}

/// Moulded plastic in a colour.
pub fn plastic(dice: &mut Dice, color: Vec3) -> Material {
    let family = dice.family(&finishes(Stuff::Plastic));
    let noise = Noise(dice.seed());
    let canvas = Canvas::new(64, 64, color).each(|uv, c| match family {
        "grained" => c * (0.9 + 0.2 * noise.smooth(uv, (32, 32))),
        "marbled" => c.lerp(Vec3::ONE, 0.45 * (TAU * (uv.x + 1.5 * noise.cloud(uv, (2, 2)))).sin().abs().powi(6)),
        "flecked" => c.lerp(Vec3::splat(0.8), if noise.spots(uv, (14, 14)) < 0.16 { 0.35 } else { 0.0 }),
        _ => c * (0.98 + 0.04 * noise.smooth(uv, (8, 8))),
    });
    material("plastic", &canvas, 0.0, 0.4)
}

/// Rubber: dark, matt.
pub fn rubber(dice: &mut Dice) -> Material {
    let tone = dice.tint(Vec3::splat(0.13), 0.3);
    rubber_of(dice, tone)
}

/// Rubber of a colour.
pub fn rubber_of(dice: &mut Dice, color: Vec3) -> Material {
    let noise = Noise(dice.seed());
    let canvas = Canvas::new(32, 32, color).each(|uv, c| c * (0.92 + 0.16 * noise.smooth(uv, (24, 24))));
    material("rubber", &canvas, 0.0, 0.8)
}

/// Woven cloth, one tile for the whole piece: u along the long way, v across.
pub fn cloth(dice: &mut Dice) -> Material {
    let family = dice.family(&finishes(Stuff::Cloth));
    let noise = Noise(dice.seed());
    let pale = dice.chance(0.5);
    let base = if pale { dice.color((0.02, 0.16), (0.82, 0.96)) } else { dice.color((0.35, 0.75), (0.4, 0.8)) };
    let accent = if pale { dice.vivid() } else { dice.color((0.02, 0.15), (0.85, 0.97)) };
    let (width, period) = (dice.any(0.03, 0.07), dice.any(6.0, 11.0).floor());
    let canvas = Canvas::new(192, 128, base).each(|uv, _| {
        let edge = uv.y.min(1.0 - uv.y);
        let stripe = |x: f32, share: f32| (x * period).fract() < share;
        let color = match family {
            "border" if (edge - 0.14).abs() < width || (edge - 0.26).abs() < width * 0.4 => accent,
            "stripes" if stripe(uv.y, 0.35) => accent,
            "check" => {
                let threads = u8::from(stripe(uv.y, 0.5)) + u8::from(stripe(uv.x * 1.5, 0.5));
                base.lerp(accent, 0.5 * f32::from(threads))
            }
            "gradient" => base.lerp(accent, uv.y),
            "pinstripe" if stripe(uv.y * 2.0, 0.16) => accent,
            // A band without pile near both ends.
            "plain" if (edge - 0.12).abs() < width * 0.6 => base * 0.82,
            _ => base,
        };
        let weave = 0.5 + 0.25 * ((TAU * uv.x * 64.0).sin() + (TAU * uv.y * 42.0).sin());
        color * (0.86 + 0.1 * weave + 0.12 * (noise.smooth(uv, (96, 64)) - 0.5))
    });
    material("cloth", &canvas, 0.0, 0.95)
}

/// Foam with pores, one tile for about 5 cm.
pub fn foam(dice: &mut Dice, color: Vec3) -> Material {
    let family = dice.family(&finishes(Stuff::Foam));
    let noise = Noise(dice.seed());
    let (cells, size) = match family {
        "fine" => ((20, 20), 0.26),
        "coarse" => ((11, 11), 0.30),
        "open" => ((15, 15), 0.36),
        _ => ((9, 9), 0.24),
    };
    let second = Noise(noise.0 ^ 0xA5A5);
    let canvas = Canvas::new(128, 128, color).each(|uv, c| {
        let mut depth = (noise.spots(uv, cells) / size).min(1.0);
        if family == "mixed" {
            depth = depth.min((second.spots(uv, (24, 24)) / 0.22).min(1.0));
        }
        c * (0.55 + 0.45 * depth.powf(1.5)) * (0.95 + 0.1 * noise.smooth(uv, (32, 32)))
    });
    material("foam", &canvas, 0.0, 0.95)
}

/// Scouring fibre, one tile for about 5 cm.
pub fn scourer(dice: &mut Dice, color: Vec3) -> Material {
    let noise = Noise(dice.seed());
    let canvas = Canvas::new(64, 64, color).each(|uv, c| {
        let fibre = 0.5 * noise.smooth(uv, (40, 12)) + 0.5 * Noise(noise.0 ^ 9).smooth(uv, (12, 40));
        c * (0.6 + 0.7 * fibre)
    });
    material("foam", &canvas, 0.0, 0.95)
}

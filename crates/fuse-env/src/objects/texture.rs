//! Procedural textures: a canvas in sRGB and the noise to paint it with.

use std::sync::Arc;

use fuse_render::Texture;
use glam::{Vec2, Vec3};

/// An image under construction; colours are sRGB in [0, 1].
#[derive(Clone, Debug)]
pub struct Canvas {
    width: u32,
    height: u32,
    pixels: Vec<Vec3>,
}

impl Canvas {
    /// A canvas of one colour.
    pub fn new(width: u32, height: u32, color: Vec3) -> Self {
        Self { width, height, pixels: vec![color; (width * height) as usize] }
    }

    /// Repaints every texel: `paint(uv of its centre, its colour)`.
    #[must_use]
    pub fn each(mut self, paint: impl Fn(Vec2, Vec3) -> Vec3) -> Self {
        for y in 0..self.height {
            for x in 0..self.width {
                let at = Vec2::new((x as f32 + 0.5) / self.width as f32, (y as f32 + 0.5) / self.height as f32);
                let i = (y * self.width + x) as usize;
                self.pixels[i] = paint(at, self.pixels[i]);
            }
        }
        self
    }

    /// Fills a rectangle given by its corners in [0, 1].
    pub fn rectangle(&mut self, low: Vec2, high: Vec2, color: Vec3) {
        let size = Vec2::new(self.width as f32, self.height as f32);
        let (a, b) = ((low * size).round(), (high * size).round());
        for y in a.y.max(0.0) as u32..(b.y.max(0.0) as u32).min(self.height) {
            for x in a.x.max(0.0) as u32..(b.x.max(0.0) as u32).min(self.width) {
                self.pixels[(y * self.width + x) as usize] = color;
            }
        }
    }

    /// Draws a digit, `size` texels per dot of its 3 × 5 grid, upper left corner at texel
    /// `(x, y)`.
    pub fn digit(&mut self, digit: u32, x: i64, y: i64, size: i64, color: Vec3) {
        const GLYPHS: [u16; 10] = [0x7B6F, 0x2C97, 0x73E7, 0x73CF, 0x5BC9, 0x79CF, 0x79EF, 0x7249, 0x7BEF, 0x7BCF];
        for dot in 0..15 {
            if GLYPHS[(digit % 10) as usize] >> (14 - dot) & 1 == 0 {
                continue;
            }
            for dy in 0..size {
                for dx in 0..size {
                    self.dot(x + i64::from(dot % 3) * size + dx, y + i64::from(dot / 3) * size + dy, color);
                }
            }
        }
    }

    /// Sets one texel; outside is ignored.
    pub fn dot(&mut self, x: i64, y: i64, color: Vec3) {
        if (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y) {
            self.pixels[(y * i64::from(self.width) + x) as usize] = color;
        }
    }

    /// Lines of dashes that look like text, inside a rectangle in [0, 1].
    pub fn text(&mut self, low: Vec2, high: Vec2, lines: usize, color: Vec3, noise: Noise) {
        let step = (high.y - low.y) / lines as f32;
        for line in 0..lines {
            let y = low.y + step * line as f32;
            let mut x = low.x;
            let mut word = 0;
            let end = high.x - (high.x - low.x) * 0.35 * noise.at(line as u32, 77);
            while x < end {
                let length = (high.x - low.x) * (0.05 + 0.16 * noise.at(line as u32, word));
                self.rectangle(Vec2::new(x, y), Vec2::new((x + length).min(end), y + step * 0.55), color);
                x += length + (high.x - low.x) * 0.035;
                word += 1;
            }
        }
    }

    /// The canvas as an 8-bit texture.
    pub fn texture(&self) -> Arc<Texture> {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let texels = self.pixels.iter().map(|p| [byte(p.x), byte(p.y), byte(p.z), 255]).collect();
        Arc::new(Texture { width: self.width, height: self.height, texels })
    }
}

/// Value noise that repeats on [0, 1]².
#[derive(Clone, Copy, Debug)]
pub struct Noise(pub u32);

impl Noise {
    /// A value in [0, 1) at an integer lattice point.
    pub fn at(self, x: u32, y: u32) -> f32 {
        let mut h = self.0 ^ x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B);
        h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
        h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
        ((h ^ (h >> 16)) >> 8) as f32 / (1 << 24) as f32
    }

    /// Smooth noise in [0, 1) with `cells` lattice cells per tile and axis.
    pub fn smooth(self, uv: Vec2, cells: (u32, u32)) -> f32 {
        let p = uv * Vec2::new(cells.0 as f32, cells.1 as f32);
        let (base, f) = (p.floor(), p - p.floor());
        let f = f * f * (Vec2::splat(3.0) - 2.0 * f);
        let wrap = |v: f32, n: u32| (v as i64).rem_euclid(i64::from(n)) as u32;
        let corner = |dx: f32, dy: f32| self.at(wrap(base.x + dx, cells.0), wrap(base.y + dy, cells.1));
        let (low, high) = (
            corner(0.0, 0.0) * (1.0 - f.x) + corner(1.0, 0.0) * f.x,
            corner(0.0, 1.0) * (1.0 - f.x) + corner(1.0, 1.0) * f.x,
        );
        low * (1.0 - f.y) + high * f.y
    }

    /// Three octaves of smooth noise, in [0, 1).
    pub fn cloud(self, uv: Vec2, cells: (u32, u32)) -> f32 {
        let octave = |k: u32| Noise(self.0.wrapping_add(k * 0x51_7CC1)).smooth(uv, (cells.0 << k, cells.1 << k));
        (octave(0) * 4.0 + octave(1) * 2.0 + octave(2)) / 7.0
    }

    /// Distance to the nearest of one random point per cell, in cells.
    pub fn spots(self, uv: Vec2, cells: (u32, u32)) -> f32 {
        let p = uv * Vec2::new(cells.0 as f32, cells.1 as f32);
        let base = p.floor();
        let mut best = 9.0f32;
        for dy in -1..=1i64 {
            for dx in -1..=1i64 {
                let cell = base + Vec2::new(dx as f32, dy as f32);
                let x = (cell.x as i64).rem_euclid(i64::from(cells.0)) as u32;
                let y = (cell.y as i64).rem_euclid(i64::from(cells.1)) as u32;
                let point = cell + Vec2::new(self.at(x, y), self.at(x + 7919, y));
                best = best.min(point.distance(p));
            }
        }
        best
    }
}

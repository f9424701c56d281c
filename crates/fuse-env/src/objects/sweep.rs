//! Solids made by sweeping: surfaces of revolution, tubes, extrusions, rounded boxes.

use std::f32::consts::{FRAC_PI_2, TAU};
use std::ops::{Add, Mul};

use glam::{Vec2, Vec3};

use super::shape::{Ends, Surface};

/// How a swept tube ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tip {
    /// A flat cap.
    Flat,
    /// A dome.
    Round,
    /// An open mouth: wall thickness and depth of the bore, metres.
    Mouth(f32, f32),
}

/// `per` points per stretch of a Catmull-Rom curve through `controls`, end points included.
pub fn spline<T>(controls: &[T], per: usize) -> Vec<T>
where
    T: Copy + Add<Output = T> + Mul<f32, Output = T>,
{
    let last = controls.len() - 1;
    let mut points = vec![];
    for i in 0..last {
        let [a, b] = [controls[i], controls[i + 1]];
        let before = if i == 0 { a * 2.0 + b * -1.0 } else { controls[i - 1] };
        let after = if i + 1 == last { b * 2.0 + a * -1.0 } else { controls[i + 2] };
        for k in 0..per {
            let t = k as f32 / per as f32;
            let (t2, t3) = (t * t, t * t * t);
            points.push(
                before * (-0.5 * t3 + t2 - 0.5 * t)
                    + a * (1.5 * t3 - 2.5 * t2 + 1.0)
                    + b * (-1.5 * t3 + 2.0 * t2 + 0.5 * t)
                    + after * (0.5 * t3 - 0.5 * t2),
            );
        }
    }
    points.push(controls[last]);
    points
}

/// Linear interpolation in a table of `(t, value)` with smooth steps between the entries.
pub fn along(table: &[(f32, f32)], t: f32) -> f32 {
    let mut value = table[0].1;
    for pair in table.windows(2) {
        let s = ((t - pair[0].0) / (pair[1].0 - pair[0].0)).clamp(0.0, 1.0);
        if t >= pair[0].0 {
            value = pair[0].1 + (pair[1].1 - pair[0].1) * s * s * (3.0 - 2.0 * s);
        }
    }
    value
}

/// `n` points of a superellipse with half-axes `rx`, `ry`; exponent 2 is an ellipse, larger is
/// boxier.
pub fn superellipse(rx: f32, ry: f32, exponent: f32, n: usize) -> Vec<Vec2> {
    (0..n)
        .map(|k| {
            let (s, c) = (TAU * k as f32 / n as f32).sin_cos();
            Vec2::new(rx * c.signum() * c.abs().powf(2.0 / exponent), ry * s.signum() * s.abs().powf(2.0 / exponent))
        })
        .collect()
}

/// A rectangle of half-sizes `hx`, `hy` whose corners have radius `r`, `4 (k + 1)` points.
pub fn rounded_rectangle(hx: f32, hy: f32, r: f32, k: usize) -> Vec<Vec2> {
    let r = r.min(hx * 0.999).min(hy * 0.999).max(1e-6);
    let centres = [(hx - r, hy - r), (r - hx, hy - r), (r - hx, r - hy), (hx - r, r - hy)];
    (0..4 * (k + 1))
        .map(|i| {
            let (corner, step) = (i / (k + 1), i % (k + 1));
            let (s, c) = (FRAC_PI_2 * (corner as f32 + step as f32 / k as f32)).sin_cos();
            Vec2::new(centres[corner].0 + r * c, centres[corner].1 + r * s)
        })
        .collect()
}

/// The surface of revolution of a profile `(radius, z)` about z, `n` segments; radii of zero
/// are poles. `v` runs along the profile.
pub fn revolve(profile: &[Vec2], n: usize) -> Surface {
    let rings: Vec<Vec<Vec3>> = profile
        .iter()
        .map(|p| {
            if p.x < 1e-6 {
                return vec![Vec3::new(0.0, 0.0, p.y)];
            }
            (0..n)
                .map(|k| {
                    let (s, c) = (TAU * k as f32 / n as f32).sin_cos();
                    Vec3::new(p.x * c, p.x * s, p.y)
                })
                .collect()
        })
        .collect();
    Surface::loft(&rings, Ends::Capped)
}

/// Profile of a vessel's wall: up the `outer` profile (from the foot's edge to the rim), over a
/// rounded rim and down inside, `wall` metres thick, to a floor `floor` metres above the lowest
/// point. Both ends lie on the axis.
pub fn hollow(outer: &[Vec2], wall: f32, floor: f32) -> Vec<Vec2> {
    let foot = outer[0];
    let rim = outer[outer.len() - 1];
    let mut profile = vec![Vec2::new(0.0, foot.y)];
    profile.extend_from_slice(outer);
    for k in 1..4 {
        let (s, c) = (std::f32::consts::PI * k as f32 / 4.0).sin_cos();
        profile.push(Vec2::new(rim.x - wall / 2.0 + wall / 2.0 * c, rim.y + wall / 2.0 * s));
    }
    let base = foot.y + floor;
    let inside: Vec<Vec2> =
        outer.iter().rev().map(|p| Vec2::new((p.x - wall).max(wall), p.y)).filter(|p| p.y > base + wall).collect();
    let last = inside.last().copied().unwrap_or(rim);
    profile.extend_from_slice(&inside);
    profile.push(Vec2::new(last.x * 0.93, base + (last.y - base) * 0.35));
    profile.push(Vec2::new(last.x * 0.78, base));
    profile.push(Vec2::new(0.0, base));
    profile
}

/// Sweeps sections along a path. A section's first coordinate runs along `tangent × up`, its
/// second along the direction nearest to `up`.
pub fn sweep(path: &[Vec3], up: Vec3, ends: Ends, section: impl Fn(usize, f32) -> Vec<Vec2>) -> Surface {
    Surface::loft(&rings(path, up, ends, section), ends)
}

fn rings(path: &[Vec3], up: Vec3, ends: Ends, section: impl Fn(usize, f32) -> Vec<Vec2>) -> Vec<Vec<Vec3>> {
    let n = path.len();
    (0..n)
        .map(|i| {
            let (before, after) = match ends {
                Ends::Joined => (path[(i + n - 1) % n], path[(i + 1) % n]),
                Ends::Capped => (path[i.saturating_sub(1)], path[(i + 1).min(n - 1)]),
            };
            let side = (after - before).cross(up).normalize_or_zero();
            let over = side.cross(after - before).normalize_or_zero();
            section(i, i as f32 / (n - 1).max(1) as f32).iter().map(|s| path[i] + side * s.x + over * s.y).collect()
        })
        .collect()
}

/// A tube with elliptic sections: `radii(t)` gives half-axes across and along `up`.
pub fn tube(path: &[Vec3], up: Vec3, n: usize, tips: [Tip; 2], radii: impl Fn(f32) -> (f32, f32)) -> Surface {
    let last = path.len() - 1;
    let mut body = rings(path, up, Ends::Capped, |_, t| {
        let (a, b) = radii(t);
        superellipse(a, b, 2.0, n)
    });
    let start = end_rings(&body[0], path[0], (path[0] - path[1]).normalize_or_zero(), tips[0]);
    let finish = end_rings(&body[last], path[last], (path[last] - path[last - 1]).normalize_or_zero(), tips[1]);
    body.splice(0..0, start.into_iter().rev());
    body.extend(finish);
    Surface::loft(&body, Ends::Capped)
}

/// The rings that follow `ring` at a tube's end, from it outwards.
fn end_rings(ring: &[Vec3], centre: Vec3, outward: Vec3, tip: Tip) -> Vec<Vec<Vec3>> {
    let radius = ring.iter().map(|p| p.distance(centre)).fold(f32::MAX, f32::min);
    let scaled = |scale: f32, shift: f32| -> Vec<Vec3> {
        ring.iter().map(|p| centre + (*p - centre) * scale + outward * shift).collect()
    };
    match tip {
        Tip::Flat => vec![],
        Tip::Round => {
            let mut out: Vec<_> = (1..4)
                .map(|k| {
                    let (s, c) = (FRAC_PI_2 * k as f32 / 4.0).sin_cos();
                    scaled(c, radius * s)
                })
                .collect();
            out.push(vec![centre + outward * radius]);
            out
        }
        Tip::Mouth(wall, depth) => {
            let inner = (1.0 - wall / radius).max(0.2);
            vec![scaled(inner, 0.0), scaled(inner * 0.9, -depth), vec![centre - outward * depth]]
        }
    }
}

/// A ring for a cyclic handle: an elliptic tube around a closed path.
pub fn loop_tube(path: &[Vec3], up: Vec3, n: usize, radii: impl Fn(f32) -> (f32, f32)) -> Surface {
    sweep(path, up, Ends::Joined, |_, t| {
        let (a, b) = radii(t);
        superellipse(a, b, 2.5, n)
    })
}

/// An outline (counter-clockwise, in x and y) between two heights, edges bevelled by `bevel`.
pub fn extrude(outline: &[Vec2], low: f32, high: f32, bevel: f32) -> Surface {
    let n = outline.len();
    let inset: Vec<Vec2> = (0..n)
        .map(|k| {
            let (a, b, c) = (outline[(k + n - 1) % n], outline[k], outline[(k + 1) % n]);
            let inward = (b - a).normalize_or_zero().perp() + (c - b).normalize_or_zero().perp();
            b + inward.normalize_or_zero() * bevel
        })
        .collect();
    let ring = |points: &[Vec2], z: f32| points.iter().map(|p| p.extend(z)).collect::<Vec<_>>();
    let rings = if bevel > 0.0 {
        vec![ring(&inset, low), ring(outline, low + bevel), ring(outline, high - bevel), ring(&inset, high)]
    } else {
        vec![ring(outline, low), ring(outline, high)]
    };
    Surface::loft(&rings, Ends::Capped)
}

/// A box centred on the origin with edges rounded by `edge` and vertical edges by `corner`.
pub fn rounded_box(size: Vec3, corner: f32, edge: f32) -> Surface {
    let half = size / 2.0;
    let edge = edge.min(half.min_element() * 0.98);
    let steps = 3;
    let mut levels = vec![];
    for k in 0..=steps {
        let (s, c) = (FRAC_PI_2 * k as f32 / steps as f32).sin_cos();
        levels.push((edge * (1.0 - s), -half.z + edge * (1.0 - c)));
    }
    let upper: Vec<_> = levels.iter().rev().map(|&(inset, z)| (inset, -z)).collect();
    levels.extend(upper);
    let rings: Vec<Vec<Vec3>> = levels
        .iter()
        .map(|&(inset, z)| {
            rounded_rectangle(half.x - inset, half.y - inset, (corner - inset).max(edge * 0.3), 4)
                .iter()
                .map(|p| p.extend(z))
                .collect()
        })
        .collect();
    Surface::loft(&rings, Ends::Capped)
}

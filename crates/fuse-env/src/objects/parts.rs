//! Parts that several things share: plain materials, outlines stood on edge, shells with holes.

use std::f32::consts::TAU;

use glam::{Mat3, Quat, Vec2, Vec3};

use super::Workshop;
use super::finish::{material, plastic, rubber_of, steel, wood};
use super::shape::{Ends, Face, Surface};
use super::sweep::{extrude, revolve, superellipse, sweep};
use super::texture::Canvas;

/// Plastic in one of the split's lively colours.
pub fn vivid_plastic(w: &mut Workshop) -> usize {
    let tone = w.dice.vivid();
    w.material(|d| plastic(d, tone))
}

/// Nearly black plastic.
pub fn dark_plastic(w: &mut Workshop) -> usize {
    let tone = w.dice.tint(Vec3::splat(0.12), 0.3);
    w.material(|d| plastic(d, tone))
}

/// Rubber in one of the split's lively colours.
pub fn vivid_rubber(w: &mut Workshop) -> usize {
    let tone = w.dice.vivid() * 0.9;
    w.material(|d| rubber_of(d, tone))
}

/// A material of one colour; `name` also stands for a density.
pub fn plain(w: &mut Workshop, name: &str, color: Vec3, roughness: f32) -> usize {
    let metallic = if name == "steel" { 0.6 } else { 0.0 };
    w.material(|_| material(name, &Canvas::new(4, 4, color), metallic, roughness))
}

/// Wood with probability `wooden`, dark plastic with `dark`, a lively plastic otherwise.
pub fn grip_stuff(w: &mut Workshop, wooden: f32, dark: f32) -> usize {
    let kind = w.dice.unit();
    if kind < wooden {
        w.material(wood)
    } else if kind < wooden + dark {
        dark_plastic(w)
    } else {
        vivid_plastic(w)
    }
}

/// Gives a material the density of another: the faces of one solid must weigh alike, as its mass is
/// an integral over all of them.
pub fn weigh_alike(w: &mut Workshop, stuff: usize, like: usize) {
    let name = w.model.materials[like].name.clone();
    w.model.materials[stuff].name = name;
}

/// Adds a part of steel, its texture at true size.
pub fn add_steel(w: &mut Workshop, surface: Surface, crease: f32) -> usize {
    let metal = w.material(steel);
    w.add(surface.uv_box(Vec2::splat(0.06)), metal, crease);
    metal
}

/// An outline in x and z, counter-clockwise, drawn out along y to `width` about y = 0.
pub fn on_edge(outline: &[Vec2], width: f32, bevel: f32) -> Surface {
    extrude(outline, -width / 2.0, width / 2.0, bevel).map(|p| Vec3::new(p.x, -p.z, p.y))
}

/// A solid of revolution about the x axis from a profile `(radius, x)`.
pub fn about_x(profile: &[Vec2], n: usize) -> Surface {
    revolve(profile, n).turned(Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, Vec3::X)))
}

/// A solid of revolution about the y axis from a profile `(radius, y)`.
pub fn about_y(profile: &[Vec2], n: usize) -> Surface {
    revolve(profile, n).turned(Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, Vec3::Y)))
}

/// Profile of a disc of a radius between two heights, its edges broken by `edge`.
pub fn disc(radius: f32, low: f32, high: f32, edge: f32) -> Vec<Vec2> {
    vec![
        Vec2::new(0.0, low),
        Vec2::new(radius - edge, low),
        Vec2::new(radius, low + edge),
        Vec2::new(radius, high - edge),
        Vec2::new(radius - edge, high),
        Vec2::new(0.0, high),
    ]
}

/// A box centred on the origin, its edges sharp: for parts of a millimetre or two.
pub fn bar(size: Vec3) -> Surface {
    let (x, y) = (size.x / 2.0, size.y / 2.0);
    let outline = [Vec2::new(-x, -y), Vec2::new(x, -y), Vec2::new(x, y), Vec2::new(-x, y)];
    extrude(&outline, -size.z / 2.0, size.z / 2.0, 0.0)
}

/// A torus about z: `radius` of its middle line, half-axes of its section across and along z,
/// `boxy` the exponent of the section (2 is an ellipse).
pub fn torus(radius: f32, across: f32, along: f32, boxy: f32, n: usize) -> Surface {
    let path: Vec<Vec3> = (0..n)
        .map(|k| {
            let (s, c) = (TAU * k as f32 / n as f32).sin_cos();
            Vec3::new(radius * c, radius * s, 0.0)
        })
        .collect();
    sweep(&path, Vec3::Z, Ends::Joined, |_, _| superellipse(across, along, boxy, 8))
}

/// Points of a polyline with its corners cut round: each corner becomes an arc of `steps` + 1
/// points that starts `radius` before it; `closed` rounds the first and last corner too.
pub fn rounded(corners: &[Vec2], radius: f32, steps: usize) -> Vec<Vec2> {
    let n = corners.len();
    let mut points = vec![];
    for k in 0..n {
        let (a, b, c) = (corners[(k + n - 1) % n], corners[k], corners[(k + 1) % n]);
        let reach = |from: Vec2| radius.min(from.distance(b) * 0.45);
        let (p, q) = (b + (a - b).normalize_or_zero() * reach(a), b + (c - b).normalize_or_zero() * reach(c));
        for i in 0..=steps {
            let t = i as f32 / steps as f32;
            points.push(p * (1.0 - t) * (1.0 - t) + b * 2.0 * t * (1.0 - t) + q * t * t);
        }
    }
    points
}

/// A thin closed shell on a grid around an axis: `at(v, u)` gives its outer and its inner point,
/// `v` in [0, 1] from the pole to the open rim, `u` in [0, 1) around. Cells for which
/// `hole(row, column)` holds are cut through.
pub fn shell(
    rows: usize,
    columns: usize,
    at: impl Fn(f32, f32) -> (Vec3, Vec3),
    hole: impl Fn(usize, usize) -> bool,
) -> Surface {
    let grid = |side: fn((Vec3, Vec3)) -> Vec3| {
        let mut points = vec![side(at(0.0, 0.0))];
        for r in 1..=rows {
            points.extend((0..columns).map(|c| side(at(r as f32 / rows as f32, c as f32 / columns as f32))));
        }
        points
    };
    let mut points = grid(|p| p.0);
    let inner = points.len() as u32;
    points.extend(grid(|p| p.1));
    let corner = |r: usize, c: usize, shift: u32| {
        let index = if r == 0 { 0 } else { 1 + (r - 1) * columns + c % columns } as u32;
        (index + shift, Vec2::new(c as f32 / columns as f32, r as f32 / rows as f32))
    };
    let mut faces = vec![];
    let mut quad = |q: [(u32, Vec2); 4]| {
        for [a, b, c] in [[q[0], q[1], q[2]], [q[0], q[2], q[3]]] {
            if a.0 != b.0 && b.0 != c.0 && c.0 != a.0 {
                faces.push(Face { at: [a.0, b.0, c.0], uv: [a.1, b.1, c.1] });
            }
        }
    };
    for r in 0..rows {
        for c in 0..columns {
            let cell = |shift| {
                [corner(r + 1, c, shift), corner(r + 1, c + 1, shift), corner(r, c + 1, shift), corner(r, c, shift)]
            };
            let (out, inn) = (cell(0), cell(inner));
            if r > 0 && hole(r, c) {
                for k in 0..4 {
                    let n = (k + 1) % 4;
                    quad([out[k], out[n], inn[n], inn[k]]);
                }
            } else {
                quad(out);
                quad([inn[3], inn[2], inn[1], inn[0]]);
            }
            if r + 1 == rows {
                quad([out[1], out[0], inn[0], inn[1]]);
            }
        }
    }
    // Winds outwards whatever the grid's handedness.
    Surface { points, faces }.map(|p| p)
}

/// Whether a cell is a hole of a staggered pattern in rows `first..last`: no two holes touch.
pub fn staggered(row: usize, column: usize, first: usize, last: usize) -> bool {
    (first..last).contains(&row) && (row - first).is_multiple_of(2) && (column + (row - first) / 2).is_multiple_of(2)
}

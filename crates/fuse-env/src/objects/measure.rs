//! What a foreign model is like: closed or open, volume, mass, centre of mass.

use std::collections::HashMap;

use fuse_render::Model;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::resting::hull;

/// What a centre of mass was computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MassFrom {
    /// The closed solid, evenly filled.
    Solid,
    /// The convex hull, evenly filled, because the surface is open or encloses nothing.
    Hull,
}

/// What was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measures {
    /// Whether every edge is passed as often one way as the other.
    pub closed: bool,
    /// How many edges are not.
    pub open_edges: usize,
    /// Cubic metres, of the solid or of the hull.
    pub volume: f64,
    /// Kilograms, an estimate.
    pub mass: f64,
    /// Centre of mass, metres, of even density.
    pub centre: DVec3,
    /// What the last three were computed from.
    pub mass_from: MassFrom,
}

/// Kilograms per cubic metre of a solid: between wood and ceramic.
const SOLID: f64 = 1000.0;
/// The same of a hull: most of it is air.
const HULL: f64 = 250.0;
/// Share of the hull that a solid must fill to count as one: thin walls do, a crumpled sheet does
/// not.
const FILLED: f64 = 1e-3;

/// Measures a model, all of it taken as of one density.
pub fn measure(model: &Model) -> Measures {
    let open_edges = open_edges(model);
    let triangles =
        model.meshes.iter().flat_map(|m| m.triangles.iter().map(|t| t.map(|i| m.positions[i as usize].as_dvec3())));
    let (volume, moment) = solid(triangles);
    let (mut whole, mut centre) = (0.0, DVec3::ZERO);
    match hull(model) {
        Some(hull) => {
            let (v, m) = solid(hull.faces.iter().map(|f| f.map(|i| hull.points[i])));
            (whole, centre) = (v, m / v);
        }
        // Flat: nothing is enclosed.
        None => {
            if let Some((low, high)) = model.bounds() {
                centre = (low + high).as_dvec3() / 2.0;
            }
        }
    }
    let closed = open_edges == 0;
    // Faces that all look inwards enclose a negative volume: it is a solid all the same.
    if closed && volume.abs() > FILLED * whole && volume != 0.0 {
        let (volume, centre) = (volume.abs(), moment / volume);
        return Measures { closed, open_edges, volume, mass: volume * SOLID, centre, mass_from: MassFrom::Solid };
    }
    Measures { closed, open_edges, volume: whole, mass: whole * HULL, centre, mass_from: MassFrom::Hull }
}

/// Signed volume and first moment of what triangles enclose.
fn solid(triangles: impl Iterator<Item = [DVec3; 3]>) -> (f64, DVec3) {
    triangles.fold((0.0, DVec3::ZERO), |(volume, moment), [a, b, c]| {
        let v = a.dot(b.cross(c)) / 6.0;
        (volume + v, moment + v * (a + b + c) / 4.0)
    })
}

/// Edges that are not passed as often one way as the other; vertices closer than a hundred
/// thousandth of the model's size are one.
fn open_edges(model: &Model) -> usize {
    let Some((low, high)) = model.bounds() else { return 0 };
    let grid = f64::from((high - low).max_element()).max(1e-9) * 1e-5;
    let mut corners: HashMap<[i64; 3], u32> = HashMap::new();
    let mut turns: HashMap<(u32, u32), i32> = HashMap::new();
    for mesh in &model.meshes {
        let at: Vec<u32> = mesh
            .positions
            .iter()
            .map(|p| {
                let cell = (*p - low).as_dvec3().to_array().map(|v| (v / grid).round() as i64);
                let next = corners.len() as u32;
                *corners.entry(cell).or_insert(next)
            })
            .collect();
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| at[i as usize]);
            if a != b && b != c && c != a {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *turns.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
                }
            }
        }
    }
    turns.values().filter(|n| **n != 0).count()
}

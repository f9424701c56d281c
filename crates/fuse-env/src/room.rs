//! The room, its furniture and the table, as models in world coordinates (instance id 0).

mod decor;
mod shapes;

use std::f32::consts::TAU;
use std::sync::Arc;

use fuse_render::{Material, Model, Texture};
use glam::{Vec2, Vec3};

use crate::configuration::{SceneConfiguration, Surface, Table, TableShape};
use crate::surfaces;
use shapes::Builder;

/// Thickness of a table top, metres.
const TOP_THICKNESS: f32 = 0.03;
/// Corners of a round table's outline.
const ROUND_CORNERS: usize = 72;

/// Everything that does not move: shell of the room, what stands along its walls, the table.
///
/// Positions are world coordinates in metres; the same configuration gives the same models.
pub fn build(scene: &SceneConfiguration) -> Vec<Model> {
    vec![shell(scene), decor::along_walls(scene), table(&scene.table)]
}

/// Outline of the table top in world x and y, counter-clockwise, convex.
pub fn table_outline(table: &Table) -> Vec<Vec2> {
    let (center, half) = (Vec2::from_array(table.center_m), Vec2::from_array(table.size_m) / 2.0);
    match table.shape {
        TableShape::Rectangle => {
            [Vec2::new(-1.0, -1.0), Vec2::new(1.0, -1.0), Vec2::new(1.0, 1.0), Vec2::new(-1.0, 1.0)]
                .map(|c| center + c * half)
                .to_vec()
        }
        // The physics engine's sine, the same on every machine: things are placed by this outline.
        TableShape::Round => (0..ROUND_CORNERS)
            .map(|i| rapier3d::glamx::Vec2::from_angle(TAU * i as f32 / ROUND_CORNERS as f32))
            .map(|d| center + Vec2::from_array(d.to_array()) * half)
            .collect(),
    }
}

/// A material that shows `texture`.
fn material(name: &str, texture: Arc<Texture>, roughness: f32) -> Material {
    Material {
        name: name.to_owned(),
        base_color: [1.0; 4],
        base_color_texture: Some(texture),
        metallic: 0.0,
        roughness,
        double_sided: true,
    }
}

fn painted(name: &str, surface: &Surface, size: Vec2) -> Material {
    material(name, surfaces::paint(surface, size), surface.roughness)
}

/// A surface of the same kind with another pattern.
fn reseeded(surface: &Surface, salt: u64) -> Surface {
    Surface { seed: surface.seed.wrapping_mul(31).wrapping_add(salt), ..surface.clone() }
}

fn shell(scene: &SceneConfiguration) -> Model {
    let size = Vec3::from_array(scene.room.size_m);
    let h = size / 2.0;
    let mut b = Builder::default();
    let floor = b.material(painted("floor", &scene.room.floor, Vec2::new(size.x, size.y)));
    b.quad(
        floor,
        [Vec3::new(-h.x, -h.y, 0.0), Vec3::new(h.x, -h.y, 0.0), Vec3::new(h.x, h.y, 0.0), Vec3::new(-h.x, h.y, 0.0)],
    );
    for (i, wall) in walls(size).into_iter().enumerate() {
        let m = b.material(painted("wall", &reseeded(&scene.room.wall, i as u64), Vec2::new(wall.length, size.z)));
        let half = wall.length / 2.0;
        b.quad(
            m,
            [
                wall.at(-half, 0.0, 0.0),
                wall.at(half, 0.0, 0.0),
                wall.at(half, 0.0, size.z),
                wall.at(-half, 0.0, size.z),
            ],
        );
    }
    b.finish()
}

/// A wall's own axes: `u` to the right for someone who faces it, `d` into the room, `z` up.
#[derive(Clone, Copy)]
struct Wall {
    middle: Vec3,
    right: Vec3,
    inward: Vec3,
    length: f32,
}

impl Wall {
    fn at(&self, u: f32, d: f32, z: f32) -> Vec3 {
        self.middle + self.right * u + self.inward * d + Vec3::Z * z
    }
}

fn walls(size: Vec3) -> [Wall; 4] {
    [(Vec3::NEG_X, size.x, size.y), (Vec3::NEG_Y, size.y, size.x), (Vec3::X, size.x, size.y), (Vec3::Y, size.y, size.x)]
        .map(|(inward, across, length)| Wall {
            middle: -inward * across / 2.0,
            right: Vec3::Z.cross(inward),
            inward,
            length,
        })
}

fn table(table: &Table) -> Model {
    let mut b = Builder::default();
    let outline = table_outline(table);
    let size = Vec2::from_array(table.size_m);
    let corner = Vec2::from_array(table.center_m) - size / 2.0;
    let top = b.material(painted("table top", &table.top, size));
    let frame = b.material(painted("table frame", &table.frame, Vec2::splat(0.8)));
    b.plate(top, &outline, table.height_m, corner, size);
    b.skirt(frame, &outline, table.height_m - TOP_THICKNESS, table.height_m);
    // Apron and legs stay clear of the edge.
    let inset = 0.72;
    let center = Vec2::from_array(table.center_m);
    let half = size / 2.0 * if table.shape == TableShape::Round { inset * 0.72 } else { inset + 0.16 };
    let under = table.height_m - TOP_THICKNESS;
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        let foot = center + half * Vec2::new(sx, sy);
        let low = Vec3::new(foot.x - 0.03, foot.y - 0.03, 0.0);
        b.cuboid(frame, low, Vec3::new(foot.x + 0.03, foot.y + 0.03, under), 0.8);
    }
    for side in [-1.0, 1.0] {
        let (x, y) = (half.x, half.y * side);
        let low = Vec3::new(center.x - x, center.y + y - 0.012, under - 0.08);
        b.cuboid(frame, low, Vec3::new(center.x + x, center.y + y + 0.012, under), 0.8);
        let (x, y) = (half.x * side, half.y);
        let low = Vec3::new(center.x + x - 0.012, center.y - y, under - 0.08);
        b.cuboid(frame, low, Vec3::new(center.x + x + 0.012, center.y + y, under), 0.8);
    }
    b.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::configuration;

    #[test]
    fn rooms_are_sound_models_of_the_configured_size() {
        let text = include_str!("../../../python/fuse_grounding/data/scenes.json");
        for mut scene in configuration::parse("scenes.json", text).unwrap() {
            for s in [&mut scene.room.floor, &mut scene.room.wall, &mut scene.room.wood, &mut scene.table.top] {
                s.texels = 64;
            }
            let models = build(&scene);
            assert_eq!(models, build(&scene), "{} is not deterministic", scene.name);
            let (lo, hi) = models[0].bounds().unwrap();
            assert!((hi - lo - Vec3::from_array(scene.room.size_m)).length() < 1e-4);
            let (lo, hi) = models[2].bounds().unwrap();
            assert!((hi.z - scene.table.height_m).abs() < 1e-5 && lo.z == 0.0);
            for mesh in models.iter().flat_map(|m| &m.meshes) {
                assert_eq!(mesh.positions.len(), mesh.normals.len());
                assert_eq!(mesh.positions.len(), mesh.uvs.len());
                for t in &mesh.triangles {
                    let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                    let normal = (b - a).cross(c - a);
                    assert!(normal.dot(mesh.normals[t[0] as usize]) > 0.0, "winding against the normal");
                }
            }
            // The camera ring stays out of the furniture.
            let (lo, hi) = models[1].bounds().unwrap();
            assert!(lo.z >= 0.0 && hi.z < scene.room.size_m[2]);
            let e = &scene.ellipse;
            for p in models[1].meshes.iter().flat_map(|m| &m.positions) {
                let d = (f64::from(p.x) / (e.semi_axes_m[0] + 0.1)).powi(2)
                    + (f64::from(p.y) / (e.semi_axes_m[1] + 0.1)).powi(2);
                assert!(d > 1.0, "furniture at {p} is in the camera's way");
            }
        }
    }
}

//! Exact normals, for who asks: the default path does not make them.

use fuse_camera::{Buffer, Camera};
use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::raster::{TILE_HEIGHT, TILE_WIDTH, Tile};
use super::transform::{Sampling, Setup, View};
use super::{Binned, Renderer};

impl Renderer {
    /// Unit normals of the surfaces at the pixel centres, in the camera's frame (x right, y down, z forward), facing
    /// the camera; zeros where nothing was hit. They are the triangles' own, as depth is, not those smoothed for
    /// shading.
    pub fn normals(&self, camera: &Camera) -> Buffer<[f32; 3]> {
        let view = View::new(camera, self.near);
        let binned = Binned::new(&view, &self.geometry, Sampling::Center);
        let w = view.width as usize;
        let mut normals = Buffer::filled(view.width, view.height, [0.0; 3]);
        normals.as_mut_slice().par_chunks_mut(TILE_HEIGHT * w).enumerate().for_each_init(
            || Tile::new(&view, 1),
            |tile, (ty, normals)| {
                for tx in 0..binned.tiles_x {
                    tile.reset(tx * TILE_WIDTH, ty * TILE_HEIGHT);
                    tile.draw_centers(&binned);
                    for row in 0..normals.len() / w {
                        let y = ty * TILE_HEIGHT + row;
                        for x in tx * TILE_WIDTH..((tx + 1) * TILE_WIDTH).min(w) {
                            if let Some(index) = tile.center(x, y).checked_sub(1) {
                                normals[row * w + x] = self.normal(camera, binned.setup(index), x, y);
                            }
                        }
                    }
                }
            },
        );
        normals
    }

    fn normal(&self, camera: &Camera, setup: &Setup, x: usize, y: usize) -> [f32; 3] {
        let facet: Vec3A = self.geometry.facets[setup.triangle as usize];
        let world = nalgebra::Vector3::new(facet.x, facet.y, facet.z).cast::<f64>();
        let seen = camera.pose.rotation * world;
        let ray = camera.intrinsics.unproject(x as f64 + 0.5, y as f64 + 0.5, 1.0);
        // A double-sided surface is seen from either side.
        let sign = if seen.dot(&ray.coords) > 0.0 { -1.0 } else { 1.0 };
        (sign * DVec3::new(seen.x, seen.y, seen.z).normalize()).as_vec3().to_array()
    }
}

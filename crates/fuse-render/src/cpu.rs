//! The renderer: stage order.
//!
//! transform → bin → for each tile: raster → shade. What does not depend on the camera (mip
//! chains, shadow maps, ambient occlusion) is made once in [`Renderer::new`].

mod binned;
pub(crate) mod geometry;
mod lanes;
mod mask;
mod normals;
pub(crate) mod occlusion;
mod points;
pub(crate) mod raster;
pub(crate) mod resolve;
pub(crate) mod shade;
pub(crate) mod shadow;
pub(crate) mod texture;
mod transform;

use fuse_camera::{Buffer, Camera, DepthBuffer, IdBuffer};
use glam::Vec3A;
use rayon::prelude::*;

use crate::{Amodal, Frame, RenderOptions, Scene, SceneError};
use binned::{Binned, Pool};
use geometry::Geometry;
use mask::Mask;
use occlusion::Occlusion;
use points::Triangles;
use raster::{BLOCK, LANES, TILE_HEIGHT, TILE_WIDTH, Tile};
use resolve::Colors;
use shade::Shading;
use shadow::Shadow;
use transform::{Sampling, Setup, View};

/// A scene, ready to be seen from any camera.
///
/// Frames are bit-identical for any number of threads and any SIMD level.
pub struct Renderer {
    pub(crate) geometry: Geometry,
    pub(crate) shading: Shading,
    /// Display-linear.
    pub(crate) background: Vec3A,
    pub(crate) near: f32,
    /// Nonzero instance ids, ascending.
    pub(crate) ids: Vec<u32>,
    pool: Pool,
}

impl Renderer {
    /// Prepares a scene.
    ///
    /// # Errors
    /// [`SceneError`] for an inconsistent model, a singular transform, or an option or light
    /// value out of range.
    pub fn new(scene: Scene, options: &RenderOptions) -> Result<Self, SceneError> {
        check(&scene, options)?;
        let geometry = Geometry::new(&scene)?;
        let mut ids: Vec<u32> = scene.instances.iter().map(|i| i.id).filter(|&id| id != 0).collect();
        ids.sort_unstable();
        ids.dedup();
        let shadow = options.shadows.then(|| Shadow::new(&geometry, &scene.light, options.shadow_resolution));
        let occlusion = if options.ambient_occlusion { Occlusion::new(&geometry) } else { None };
        let shading = Shading::new(&scene.light, shadow, occlusion);
        let background = shading.display_one(scene.background.into());
        Ok(Self { geometry, shading, background, near: options.near, ids, pool: Pool::default() })
    }

    /// Nonzero instance ids, ascending.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Colour, depth and ids.
    pub fn render(&self, camera: &Camera) -> Frame {
        let view = View::new(camera, self.near);
        self.pool.with(&view, &self.geometry, Sampling::Area, |binned| self.colors(camera, &view, binned))
    }

    fn colors(&self, camera: &Camera, view: &View, binned: &Binned) -> Frame {
        let center = camera.pose.center();
        let eye = Vec3A::new(center.x as f32, center.y as f32, center.z as f32);
        let (w, h) = (view.width, view.height);
        let mut frame = Frame {
            rgb: Buffer::filled(w, h, [0; 3]),
            depth: Buffer::filled(w, h, 0.0),
            instance: Buffer::filled(w, h, 0),
        };
        let band = TILE_HEIGHT * w as usize;
        let scene = Triangles { geometry: &self.geometry, binned };
        frame
            .rgb
            .as_mut_slice()
            .par_chunks_mut(band)
            .zip(frame.depth.as_mut_slice().par_chunks_mut(band))
            .zip(frame.instance.as_mut_slice().par_chunks_mut(band))
            .enumerate()
            .for_each_init(
                || (Tile::new(view, LANES), Colors::default()),
                |(tile, colors), (ty, ((rgb, depth), ids))| {
                    for tx in 0..binned.tiles_x {
                        tile.reset(tx * TILE_WIDTH, ty * TILE_HEIGHT);
                        tile.draw_area(binned);
                        let columns = tx * TILE_WIDTH..((tx + 1) * TILE_WIDTH).min(w as usize);
                        let rows = ty * TILE_HEIGHT..ty * TILE_HEIGHT + rgb.len() / w as usize;
                        colors.resolve(&scene, tile, columns.clone(), rows.clone());
                        colors.shade(&scene, &self.shading, eye);
                        for (row, y) in rows.enumerate() {
                            let at = row * w as usize + columns.start..row * w as usize + columns.end;
                            self.row(binned, tile, (columns.start, y), &mut depth[at.clone()], &mut ids[at.clone()]);
                            for rgb in &mut rgb[at] {
                                *rgb = self.shading.encode.encode(colors.pixel(self.background));
                            }
                        }
                    }
                },
            );
        frame
    }

    /// Depth and ids of pixels of one row from their centre samples, which begin at `(x, y)`.
    fn row(&self, binned: &Binned, tile: &Tile, (x, y): (usize, usize), depth: &mut [f32], ids: &mut [u32]) {
        for (k, (depth, ids)) in depth.chunks_mut(BLOCK).zip(ids.chunks_mut(BLOCK)).enumerate() {
            let x = x + k * BLOCK;
            let Some(key) = tile.whole_block(x, y) else {
                for (i, (depth, id)) in depth.iter_mut().zip(ids).enumerate() {
                    (*depth, *id) = self.center(binned, tile.samples(x + i, y)[0], x + i, y);
                }
                continue;
            };
            // The buffers are empty where nothing is seen.
            if let Some(number) = key.checked_sub(1) {
                let setup = binned.setup(number);
                ids.fill(self.id(setup));
                for (i, depth) in depth.iter_mut().enumerate() {
                    *depth = setup.depth((x + i) as f64 + 0.5, y as f64 + 0.5);
                }
            }
        }
    }

    /// Depth and ids without shading; equal to those of [`Renderer::render`].
    pub fn depth_ids(&self, camera: &Camera) -> (DepthBuffer, IdBuffer) {
        let view = View::new(camera, self.near);
        self.pool.with(&view, &self.geometry, Sampling::Center, |binned| self.centers(&view, binned))
    }

    fn centers(&self, view: &View, binned: &Binned) -> (DepthBuffer, IdBuffer) {
        let w = view.width as usize;
        let mut depth = Buffer::filled(view.width, view.height, 0.0);
        let mut ids = Buffer::filled(view.width, view.height, 0);
        let band = TILE_HEIGHT * w;
        depth
            .as_mut_slice()
            .par_chunks_mut(band)
            .zip(ids.as_mut_slice().par_chunks_mut(band))
            .enumerate()
            .for_each_init(
                || Tile::new(view, 1),
                |tile, (ty, (depth, ids))| {
                    for tx in 0..binned.tiles_x {
                        tile.reset(tx * TILE_WIDTH, ty * TILE_HEIGHT);
                        tile.draw_centers(binned);
                        for row in 0..depth.len() / w {
                            let y = ty * TILE_HEIGHT + row;
                            for x in tx * TILE_WIDTH..((tx + 1) * TILE_WIDTH).min(w) {
                                let at = row * w + x;
                                (depth[at], ids[at]) = self.center(binned, tile.center(x, y), x, y);
                            }
                        }
                    }
                },
            );
        (depth, ids)
    }

    /// Visible and unoccluded pixels of one id; zeros when the scene has no such id.
    pub fn amodal(&self, camera: &Camera, id: u32) -> Amodal {
        let all = self.amodal_all(camera);
        all.iter().find(|a| a.id == id).copied().unwrap_or(Amodal { id, ..Amodal::default() })
    }

    /// Visible and unoccluded pixels of every nonzero id, ascending by id.
    pub fn amodal_all(&self, camera: &Camera) -> Vec<Amodal> {
        let view = View::new(camera, self.near);
        self.pool.with(&view, &self.geometry, Sampling::Center, |binned| self.counts(&view, binned))
    }

    fn counts(&self, view: &View, binned: &Binned) -> Vec<Amodal> {
        let (_, visible) = self.centers(view, binned);
        let mut counts: Vec<Amodal> = self.ids.iter().map(|&id| Amodal { id, ..Amodal::default() }).collect();
        for id in visible.as_slice() {
            if let Ok(k) = self.ids.binary_search(id) {
                counts[k].visible_px += 1;
            }
        }
        counts.par_iter_mut().for_each(|count| {
            let mut mask = Mask::new(view);
            mask.draw(binned.setups().filter(|s| self.id(s) == count.id));
            count.unoccluded_px = mask.count();
        });
        counts
    }

    fn id(&self, setup: &Setup) -> u32 {
        self.geometry.parts[setup.part as usize].id
    }

    /// Depth and id of a pixel from the key of its centre sample.
    #[inline]
    fn center(&self, binned: &Binned, key: u32, x: usize, y: usize) -> (f32, u32) {
        let Some(index) = key.checked_sub(1) else { return (0.0, 0) };
        let setup = binned.setup(index);
        (setup.depth(x as f64 + 0.5, y as f64 + 0.5), self.id(setup))
    }
}

fn check(scene: &Scene, options: &RenderOptions) -> Result<(), SceneError> {
    let value = |name, expected, ok: bool, found: String| {
        if ok { Ok(()) } else { Err(SceneError::Value { name, expected, found }) }
    };
    let (o, l) = (options, &scene.light);
    value("near", "positive and finite", o.near > 0.0 && o.near.is_finite(), o.near.to_string())?;
    let r = o.shadow_resolution;
    value("shadow_resolution", "64 to 8192", (64..=8192).contains(&r), r.to_string())?;
    value("light.position", "finite", l.position.is_finite(), l.position.to_string())?;
    value("light.radius", "finite, at least 0", l.radius >= 0.0 && l.radius.is_finite(), l.radius.to_string())?;
    value("light.exposure", "positive and finite", l.exposure > 0.0 && l.exposure.is_finite(), l.exposure.to_string())?;
    let colors = [("light.intensity", l.intensity), ("light.sky", l.sky), ("light.ground", l.ground)];
    for (name, c) in colors.into_iter().chain([("background", scene.background)]) {
        value(name, "finite, at least 0", c.is_finite() && c.min_element() >= 0.0, c.to_string())?;
    }
    for b in &l.soft_boxes {
        let ok = b.direction.is_finite() && b.color.is_finite() && b.color.min_element() >= 0.0 && b.sharpness >= 0.0;
        value("light.soft_boxes", "finite, colour and sharpness at least 0", ok, format!("{b:?}"))?;
    }
    Ok(())
}

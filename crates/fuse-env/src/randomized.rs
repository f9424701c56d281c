//! Strongly randomised tabletop pictures with their truth: what the segmenter learns from.
//!
//! A picture depends on its seed alone. Objects are fresh instances of one split's parameter
//! range, any number of them; evaluation objects are refused. Part of the training objects are painted anew
//! ([`paint`]); development pictures show theirs as they are. Surfaces of training pictures come
//! from families (wood, brick, concrete, cloth, plaster) that the development and evaluation
//! scenes mix with others; development pictures use only those others.

mod paint;

use std::cell::OnceCell;
use std::f64::consts::TAU;
use std::sync::Arc;

use fuse_camera::{Camera, IdBuffer, Pinhole, PinholeError, Pose, RgbBuffer};
use fuse_render::{Instance, Light, Model, RenderOptions, Renderer, Scene, SceneError, SoftBox};
use glam::Vec3;
use nalgebra::Point3;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::catalogue::{Category, Split};
use crate::configuration::{
    Clutter, ClutterStyle, Ellipse, Lighting, Room, SceneConfiguration, Surface, SurfaceKind, Table, TableShape,
};
use crate::generate::settled;
use crate::objects;
use crate::placement::layout::Thing;
use crate::placement::solid::Solid;
use crate::placement::{self, Item, Rest};
use crate::room;

/// Pictures of one room, that is, of one set of surfaces and objects.
pub const PICTURES_PER_ROOM: usize = 16;
/// Pictures of one layout of objects.
const PICTURES_PER_LAYOUT: usize = 4;
/// Share of the layouts that physics settles; the others lie side by side, which is faster.
const SETTLED: f64 = 0.5;
/// Choices of things that are tried before a layout is laid side by side after all.
const SETTLE_TRIES: usize = 3;
/// Horizontal field of view of the benchmark's camera.
const FIELD_OF_VIEW_DEG: f64 = 60.0;

/// What is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Where objects and surfaces come from: training or development.
    pub split: Split,
    /// Whether the unoccluded pixels of each object are counted too (one more render each).
    pub amodal: bool,
}

/// An object of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Its id in the id image, from 1.
    pub id: u32,
    /// What it is.
    pub category: Category,
    /// Pixels that show it.
    pub visible_px: u32,
    /// Pixels that would show it if it stood alone; 0 unless asked for.
    pub unoccluded_px: u32,
}

/// A picture and its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// sRGB colour.
    pub rgb: RgbBuffer,
    /// Object ids; 0 is room and table.
    pub ids: IdBuffer,
    /// Objects of which at least one pixel shows.
    pub objects: Vec<Seen>,
}

/// Why no picture was made.
#[derive(Debug, thiserror::Error)]
pub enum RandomizedError {
    /// Evaluation objects are not for training or tuning.
    #[error("randomised pictures use split train or dev, found eval")]
    Evaluation,
    /// The picture size is not usable.
    #[error(transparent)]
    Size(#[from] PinholeError),
    /// A generated scene could not be rendered.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// `count` pictures of `seed`, [`PICTURES_PER_ROOM`] to a room; the same bits for the same arguments,
/// and a longer run begins with a shorter one's pictures.
///
/// # Errors
/// [`RandomizedError`] for the evaluation split and for sizes that no camera can have.
pub fn pictures(seed: u64, count: usize, options: &Options) -> Result<Vec<Picture>, RandomizedError> {
    if options.split == Split::Eval {
        return Err(RandomizedError::Evaluation);
    }
    let rooms: Vec<Vec<Picture>> = (0..count.div_ceil(PICTURES_PER_ROOM))
        .into_par_iter()
        .map(|index| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(index as u64 + 1);
            room_pictures(&mut rng, options, PICTURES_PER_ROOM.min(count - index * PICTURES_PER_ROOM))
        })
        .collect::<Result<_, _>>()?;
    Ok(rooms.into_iter().flatten().collect())
}

/// A generated object, how it rests, and its body once a layout needs it.
struct Made {
    category: Category,
    model: Arc<Model>,
    rests: Vec<Rest>,
    solid: OnceCell<Option<Solid>>,
}

impl Made {
    fn thing(&self) -> Option<Thing<'_>> {
        let solid = self.solid.get_or_init(|| Solid::new(&self.model)).as_ref()?;
        Some(Thing { category: self.category, item: Item { model: &self.model, rests: &self.rests }, solid })
    }
}

fn room_pictures(rng: &mut ChaCha8Rng, options: &Options, wanted: usize) -> Result<Vec<Picture>, RandomizedError> {
    let scene = random_scene(rng, options.split);
    let furniture: Vec<Arc<Model>> = room::build(&scene).into_iter().map(Arc::new).collect();
    let things = random_things(rng, options.split);
    let mut pictures = Vec::with_capacity(wanted);
    while pictures.len() < wanted {
        let (instances, categories) = layout(rng, &scene, &furniture, &things);
        let background = Vec3::splat(rng.random_range(0.05..0.8));
        let renderer =
            Renderer::new(Scene { instances, light: random_light(rng), background }, &RenderOptions::default())?;
        for _ in 0..PICTURES_PER_LAYOUT.min(wanted - pictures.len()) {
            let camera = random_camera(rng, &scene, options)?;
            pictures.push(picture(&renderer, &camera, &categories, options.amodal));
        }
    }
    Ok(pictures)
}

fn picture(renderer: &Renderer, camera: &Camera, categories: &[Category], amodal: bool) -> Picture {
    let frame = renderer.render(camera);
    let mut visible = vec![0u32; categories.len() + 1];
    for id in frame.instance.as_slice() {
        visible[*id as usize] += 1;
    }
    let alone = if amodal { renderer.amodal_all(camera) } else { Vec::new() };
    let objects = categories
        .iter()
        .enumerate()
        .map(|(i, category)| {
            let id = i as u32 + 1;
            let unoccluded_px = alone.iter().find(|a| a.id == id).map_or(0, |a| a.unoccluded_px);
            Seen { id, category: *category, visible_px: visible[i + 1], unoccluded_px }
        })
        .filter(|seen| seen.visible_px > 0)
        .collect();
    Picture { rgb: frame.rgb, ids: frame.instance, objects }
}

/// One object of every category and a few more, so that each picture holds near-misses.
fn random_things(rng: &mut ChaCha8Rng, split: Split) -> Vec<Made> {
    let mut categories = Category::ALL.to_vec();
    for _ in 0..6 {
        categories.push(Category::ALL[rng.random_range(0..Category::ALL.len())]);
    }
    categories
        .into_iter()
        .filter_map(|category| {
            let model = objects::generate(category, split, rng.random::<u64>() >> 16)?;
            let rests = objects::resting::resting_poses(&model, category.natural_share())
                .iter()
                .map(|pose| Rest { rotation: pose.rotation(), probability: pose.probability })
                .collect();
            let model = if split == Split::Train && rng.random::<f64>() < paint::SHARE {
                paint::painted(model, rng)
            } else {
                model
            };
            Some(Made { category, model: Arc::new(model), rests, solid: OnceCell::new() })
        })
        .collect()
}

/// Six to fourteen of the things on the table, fewer where there is no room; their categories by id.
fn layout(
    rng: &mut ChaCha8Rng,
    scene: &SceneConfiguration,
    furniture: &[Arc<Model>],
    things: &[Made],
) -> (Vec<Instance>, Vec<Category>) {
    let surface = placement::Surface::of(scene);
    let (order, transforms) = if rng.random::<f64>() < SETTLED {
        settle(rng, &surface, things).unwrap_or_else(|| lay_flat(rng, &surface, things))
    } else {
        lay_flat(rng, &surface, things)
    };
    let instances = furniture
        .iter()
        .map(|model| Instance { model: Arc::clone(model), transform: glam::Affine3A::IDENTITY, id: 0 })
        .chain(order.iter().zip(transforms).enumerate().map(|(i, (made, transform))| Instance {
            model: Arc::clone(&made.model),
            transform,
            id: i as u32 + 1,
        }))
        .collect();
    (instances, order.iter().map(|made| made.category).collect())
}

type Laid<'a> = (Vec<&'a Made>, Vec<glam::Affine3A>);

fn choose<'a>(rng: &mut ChaCha8Rng, things: &'a [Made]) -> Vec<&'a Made> {
    let mut order: Vec<&Made> = things.iter().collect();
    order.shuffle(rng);
    order.truncate(rng.random_range(6..=14));
    order
}

/// On the table side by side, without physics.
fn lay_flat<'a>(rng: &mut ChaCha8Rng, surface: &placement::Surface, things: &'a [Made]) -> Laid<'a> {
    let mut order = choose(rng, things);
    while !order.is_empty() {
        let items: Vec<Item<'_>> = order.iter().map(|t| Item { model: &t.model, rests: &t.rests }).collect();
        if let Ok(placed) = placement::place(&items, surface, rng) {
            return (order, placed.iter().map(placement::Placed::transform).collect());
        }
        order.pop();
    }
    (order, Vec::new())
}

/// As episodes are laid, in any of the clutter styles; `None` when nothing came to rest in a few tries.
fn settle<'a>(rng: &mut ChaCha8Rng, surface: &placement::Surface, things: &'a [Made]) -> Option<Laid<'a>> {
    use ClutterStyle::{InContainers, Leaning, OnTray, Packed, Stacked};
    let style = [Packed, Stacked, Leaning, InContainers, OnTray][rng.random_range(0..5)];
    (0..SETTLE_TRIES).find_map(|_| {
        let order = choose(rng, things);
        let bodies: Vec<Thing<'_>> = order.iter().map(|made| made.thing()).collect::<Option<_>>()?;
        let (_, poses) = settled(style, &bodies, surface, rng).ok()?;
        let transforms = poses.iter().map(|p| {
            let (q, t) = (p.rotation, p.translation);
            glam::Affine3A::from_rotation_translation(
                glam::Quat::from_xyzw(q.x, q.y, q.z, q.w).normalize(),
                Vec3::new(t.x, t.y, t.z),
            )
        });
        Some((order, transforms.collect()))
    })
}

/// Half of the cameras stand on a widened ring, as the benchmark's do; half look at something from anywhere.
fn random_camera(rng: &mut ChaCha8Rng, scene: &SceneConfiguration, options: &Options) -> Result<Camera, PinholeError> {
    let fov = (FIELD_OF_VIEW_DEG + rng.random_range(-4.0..4.0)).to_radians();
    let intrinsics = Pinhole::from_horizontal_fov(options.width, options.height, fov)?;
    let angle = rng.random_range(0.0..TAU);
    let top = f64::from(scene.table.height_m);
    let pose = if rng.random::<f64>() < 0.5 {
        let distance = rng.random_range(0.5..0.9);
        let eye = Point3::new(distance * angle.cos(), distance * angle.sin(), top + rng.random_range(0.55..0.9));
        let yaw = angle + TAU / 2.0 + rng.random_range(-0.2..0.2);
        Pose::from_yaw_pitch(eye, yaw, rng.random_range(10.0_f64..60.0).to_radians())
    } else {
        let [ex, ey] = scene.clutter.extent_m.map(f64::from);
        let at = Point3::new(rng.random_range(-ex..ex), rng.random_range(-ey..ey), top + rng.random_range(0.0..0.1));
        let distance = rng.random_range(0.6..1.4);
        let pitch = rng.random_range(15.0_f64..62.0).to_radians();
        let level = distance * pitch.cos();
        let eye = at + nalgebra::Vector3::new(level * angle.cos(), level * angle.sin(), distance * pitch.sin());
        Pose::look_at(eye, at)
    };
    Ok(Camera { intrinsics, pose })
}

fn random_light(rng: &mut ChaCha8Rng) -> Light {
    let angle = rng.random_range(0.0..std::f32::consts::TAU);
    let away = rng.random_range(0.2..1.5);
    let tint = |rng: &mut ChaCha8Rng, strength: f32, spread: f32| {
        Vec3::from_array(std::array::from_fn(|_| strength * rng.random_range(1.0 - spread..1.0 + spread)))
    };
    let key = rng.random_range(0.7_f32..4.0);
    let ambient = rng.random_range(0.15_f32..0.6);
    let soft_boxes = (0..rng.random_range(1..=3))
        .map(|_| SoftBox {
            direction: Vec3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), rng.random_range(0.2..1.0)),
            color: {
                let strength = rng.random_range(0.4..1.8);
                tint(rng, strength, 0.2)
            },
            sharpness: rng.random_range(6.0..50.0),
        })
        .collect();
    Light {
        position: Vec3::new(away * angle.cos(), away * angle.sin(), rng.random_range(1.7..2.5)),
        radius: rng.random_range(0.03..0.35),
        intensity: tint(rng, key, 0.18),
        sky: tint(rng, ambient, 0.12),
        ground: tint(rng, ambient * 0.45, 0.15),
        soft_boxes,
        exposure: rng.random_range(0.75..1.3),
    }
}

/// Table, floor and walls of random stuff and colour; textures are as fine as a picture shows them.
fn random_scene(rng: &mut ChaCha8Rng, split: Split) -> SceneConfiguration {
    use SurfaceKind::{Brick, Cloth, Concrete, Laminate, Plaster, Stone, Tiles, Wallpaper, Wood};
    let (tops, floors, walls): (&[_], &[_], &[_]) = if split == Split::Train {
        (&[Wood, Wood, Concrete, Cloth, Plaster], &[Concrete, Wood, Brick, Cloth], &[Brick, Plaster, Concrete, Wood])
    } else {
        (&[Stone, Laminate, Tiles], &[Tiles, Stone], &[Wallpaper, Tiles])
    };
    let mut paint = |kinds: &[SurfaceKind], texels| random_surface(rng, kinds, texels);
    let (top, floor, wall) = (paint(tops, 900), paint(floors, 768), paint(walls, 384));
    let (wood, frame) = (paint(&[Wood], 192), paint(&[Wood], 96));
    let side = |rng: &mut ChaCha8Rng, low, high| [rng.random_range(low..high), rng.random_range(low..high)];
    let [x, y] = side(rng, 3.6, 4.8);
    SceneConfiguration {
        name: "randomised".into(),
        split,
        description: "A random room.".into(),
        weak_texture: false,
        room: Room {
            size_m: [x, y, rng.random_range(2.4..2.8)],
            floor,
            wall,
            wood,
            decor_seed: rng.random(),
            decor_density: rng.random_range(0.2..1.0),
        },
        table: Table {
            shape: if rng.random::<f32>() < 0.6 { TableShape::Rectangle } else { TableShape::Round },
            size_m: side(rng, 1.1, 1.6),
            height_m: rng.random_range(0.7..0.8),
            center_m: [0.0, 0.0],
            top,
            frame,
        },
        light: Lighting {
            position_m: [0.0, 0.0, 2.0],
            radius_m: 0.1,
            intensity: [1.0; 3],
            sky: [0.3; 3],
            ground: [0.2; 3],
            glows: Vec::new(),
            exposure: 1.0,
        },
        ellipse: Ellipse { center_m: [0.0, 0.0], semi_axes_m: [0.7, 0.7], camera_height_m: 1.5 },
        clutter: Clutter {
            style: ClutterStyle::Packed,
            extent_m: side(rng, 0.28, 0.45),
            tightness: rng.random_range(0.2..0.95),
            distractors: [6, 14],
            gap_m: 0.004,
        },
    }
}

fn random_surface(rng: &mut ChaCha8Rng, kinds: &[SurfaceKind], texels: u32) -> Surface {
    let kind = kinds[rng.random_range(0..kinds.len())];
    // Most things that furnish a room are pale or brown; a third may have any colour.
    let free = rng.random::<f32>() < 0.35;
    let bright = rng.random_range(50.0_f32..225.0);
    let warm = rng.random_range(-0.05_f32..0.35);
    let color: [f32; 3] = if free {
        std::array::from_fn(|_| rng.random_range(30.0..235.0))
    } else {
        [bright, bright * (1.0 - 0.5 * warm), bright * (1.0 - warm)]
    };
    let other = rng.random_range(0.35_f32..1.6);
    Surface {
        kind,
        base: color.map(|v| v as u8),
        accent: color.map(|v| (v * other + rng.random_range(-20.0..20.0)).clamp(10.0, 245.0) as u8),
        contrast: rng.random_range(0.2..1.2),
        wear: rng.random_range(0.0..0.9),
        scale: rng.random_range(0.5..2.2),
        roughness: rng.random_range(0.35..0.95),
        texels,
        seed: rng.random(),
    }
}

#[cfg(test)]
mod tests;

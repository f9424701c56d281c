//! Generators of textured, real-sized things: one per category, any number of instances by
//! seed.
//!
//! Every model is a union of closed solids (each part watertight, winding outwards), in metres,
//! z up, in its natural pose on z = 0, its footprint's centre on the origin. Training,
//! development and evaluation instances draw from different ranges, shapes and finishes:
//! [`table`] and [`dice`].

mod brush;
mod cutlery;
pub mod dice;
pub mod finish;
mod handtools;
pub mod hull;
mod kitchen;
pub mod measure;
mod office;
mod pantry;
mod parts;
mod pouring;
pub mod preview;
pub mod resting;
mod scissors;
pub mod shape;
mod soft;
mod stationery;
mod strainers;
pub mod sweep;
pub mod table;
mod tableware;
#[cfg(test)]
mod tests;
pub mod texture;
mod tools;
mod vessels;
mod writing;

use fuse_render::{Material, Model};

use self::dice::Dice;
use self::shape::Surface;
use crate::catalogue::{Category, Split};

/// A model under construction and the dice that decide about it.
struct Workshop {
    category: Category,
    dice: Dice,
    model: Model,
}

impl Workshop {
    /// The instance's shape variant.
    fn shape(&mut self) -> &'static str {
        self.dice.family(&table::shapes(self.category))
    }

    /// Adds a material and returns its index.
    fn material(&mut self, make: impl FnOnce(&mut Dice) -> Material) -> usize {
        let material = make(&mut self.dice);
        self.model.materials.push(material);
        self.model.materials.len() - 1
    }

    /// Adds a part; edges sharper than `crease` degrees stay sharp.
    fn add(&mut self, surface: Surface, material: usize, crease: f32) {
        if !surface.faces.is_empty() {
            self.model.meshes.push(surface.mesh(material, crease));
        }
    }

    /// Lets the thing come to rest.
    fn settle(&mut self) {
        resting::settle(&mut self.model);
    }
}

/// The model of one instance: a function of category, split and seed alone; `None` for a category
/// of a user's library, which has no generator.
pub fn generate(category: Category, split: Split, seed: u64) -> Option<Model> {
    let mut workshop = Workshop { category, dice: Dice::new(category, split, seed), model: Model::default() };
    let make = match category {
        Category::Knife => cutlery::knife,
        Category::Scissors => scissors::scissors,
        Category::ButterKnife => cutlery::butter_knife,
        Category::Spoon => cutlery::spoon,
        Category::Ladle => cutlery::ladle,
        Category::Mug => vessels::mug,
        Category::Bowl => vessels::bowl,
        Category::Pitcher => pouring::pitcher,
        Category::WaterBottle => pouring::water_bottle,
        Category::Teapot => pouring::teapot,
        Category::Marker => stationery::marker,
        Category::Ruler => stationery::ruler,
        Category::Hammer => tools::hammer,
        Category::Mallet => tools::mallet,
        Category::Screwdriver => tools::screwdriver,
        Category::Sponge => soft::sponge,
        Category::Towel => soft::towel,
        Category::Book => stationery::book,
        Category::BoxCutter => handtools::box_cutter,
        Category::Fork => kitchen::fork,
        Category::Whisk => kitchen::whisk,
        Category::Spatula => kitchen::spatula,
        Category::Chopsticks => kitchen::chopsticks,
        Category::Tongs => kitchen::tongs,
        Category::MeasuringCup => tableware::measuring_cup,
        Category::WineGlass => tableware::wine_glass,
        Category::Plate => tableware::plate,
        Category::Tray => tableware::tray,
        Category::Colander => strainers::colander,
        Category::Sieve => strainers::sieve,
        Category::Grater => strainers::grater,
        Category::RollingPin => kitchen::rolling_pin,
        Category::Wrench => handtools::wrench,
        Category::Pliers => handtools::pliers,
        Category::TapeMeasure => office::tape_measure,
        Category::Pen => writing::pen,
        Category::Pencil => writing::pencil,
        Category::Eraser => writing::eraser,
        Category::ScrubBrush => brush::scrub_brush,
        Category::Stapler => office::stapler,
        Category::BinderClip => office::binder_clip,
        Category::TapeDispenser => office::tape_dispenser,
        Category::Flashlight => handtools::flashlight,
        Category::Candle => pantry::candle,
        Category::Can => pantry::can,
        Category::Other(_) => return None,
    };
    make(&mut workshop);
    Some(workshop.model)
}

//! Which things an episode is made of: a target for the verb, what the clutter style needs, near
//! misses, tall things that may hide the target, and others; from all categories.

use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::Validity;
use crate::catalogue::{Category, ObjectRecord};
use crate::configuration::{ClutterStyle, SceneConfiguration};
use crate::world::Stage;

/// Chance of a further valid object among the distractors, for each of two.
const SECOND_TARGET: f64 = 0.3;
/// Near misses and tall things among the distractors, at least, as far as there are any.
const NEAR: usize = 3;
const TALL: usize = 3;
/// Height from which a thing can hide another, metres.
const TALL_M: f32 = 0.085;

/// Things of one family look or are handled alike: near misses of each other.
fn families(category: Category) -> &'static [Family] {
    use Category as C;
    use Family as F;
    match category {
        C::Knife | C::BoxCutter => &[F::Blade],
        C::ButterKnife => &[F::Blade, F::Cutlery],
        C::Scissors => &[F::Blade, F::Pincer],
        C::Spatula => &[F::Blade, F::Kitchen],
        C::Spoon => &[F::Cutlery, F::Kitchen],
        C::Fork | C::Chopsticks => &[F::Cutlery],
        C::Ladle | C::Whisk => &[F::Kitchen],
        C::Sieve => &[F::Kitchen, F::Strainer],
        C::Colander => &[F::Strainer, F::Vessel],
        C::Grater => &[F::Strainer, F::Cylinder],
        C::Tongs => &[F::Pincer, F::Kitchen],
        C::Pliers => &[F::Pincer, F::Tool],
        C::BinderClip | C::Stapler => &[F::Pincer, F::Desk],
        C::Mug | C::MeasuringCup => &[F::Vessel, F::Pourer],
        C::Bowl | C::WineGlass => &[F::Vessel],
        C::Pitcher | C::Teapot => &[F::Pourer],
        C::WaterBottle => &[F::Pourer, F::Cylinder],
        C::Can | C::Candle => &[F::Cylinder, F::Vessel],
        C::Flashlight => &[F::Cylinder, F::Tool],
        C::RollingPin => &[F::Cylinder, F::Striker],
        C::Plate | C::Tray => &[F::Flat],
        C::Book => &[F::Flat, F::Block],
        C::Towel => &[F::Flat, F::Soft],
        C::Sponge | C::ScrubBrush => &[F::Soft, F::Block],
        C::Eraser => &[F::Block, F::Desk],
        C::Hammer | C::Mallet => &[F::Striker, F::Tool],
        C::Wrench => &[F::Striker, F::Tool],
        C::Screwdriver => &[F::Tool, F::Stick],
        C::Pen | C::Pencil | C::Marker => &[F::Stick],
        C::Ruler => &[F::Stick, F::Measure],
        C::TapeMeasure => &[F::Measure, F::Desk],
        C::TapeDispenser => &[F::Desk],
    }
}

/// What makes things alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    Blade,
    Block,
    Cutlery,
    Cylinder,
    Desk,
    Flat,
    Kitchen,
    Measure,
    Pincer,
    Pourer,
    Soft,
    Stick,
    Strainer,
    Striker,
    Tool,
    Vessel,
}

/// Whether two kinds of things are near misses of each other.
fn alike(a: Category, b: Category) -> bool {
    families(a).iter().any(|f| families(b).contains(f))
}

/// Categories that a clutter style needs, each with how many things of any of them.
fn needs(style: ClutterStyle) -> &'static [(&'static [Category], usize)] {
    use Category as C;
    match style {
        ClutterStyle::Sparse | ClutterStyle::Packed => &[],
        ClutterStyle::Stacked => &[
            (&[C::Plate, C::Bowl, C::Book, C::Tray, C::Towel], 3),
            (&[C::Mug, C::Bowl, C::Sponge, C::Can, C::TapeMeasure, C::Candle, C::Eraser, C::Plate], 2),
        ],
        ClutterStyle::Leaning => &[
            (&[C::Can, C::Mug, C::Pitcher, C::Teapot, C::Grater, C::Colander, C::WaterBottle, C::MeasuringCup], 2),
            (&[C::Ladle, C::Spatula, C::RollingPin, C::Whisk, C::Ruler, C::Hammer, C::Tongs, C::Sieve, C::Mallet], 3),
        ],
        ClutterStyle::InContainers => &[
            (&[C::Mug, C::MeasuringCup, C::Pitcher], 2),
            (
                &[
                    C::Spoon,
                    C::Fork,
                    C::Pen,
                    C::Pencil,
                    C::Marker,
                    C::Whisk,
                    C::ButterKnife,
                    C::Screwdriver,
                    C::Ladle,
                    C::Spatula,
                    C::Chopsticks,
                ],
                4,
            ),
        ],
        ClutterStyle::OnTray => &[
            (&[C::Tray], 1),
            (&[C::Mug, C::WineGlass, C::Bowl, C::Candle, C::Can, C::Teapot, C::Sponge, C::MeasuringCup, C::Plate], 3),
        ],
    }
}

/// A target and its distractors, the target first; `None` when no object of the scene's split is
/// valid for the verb. Unless `strict`, two further valid things may be among them.
pub(super) fn choose<'a>(
    stage: &'a Stage,
    scene: &SceneConfiguration,
    validity: &Validity,
    verb: &str,
    strict: bool,
    rng: &mut ChaCha8Rng,
) -> Option<Vec<&'a ObjectRecord>> {
    let valid = validity.get(verb)?;
    let mut all: Vec<&ObjectRecord> = stage.catalogue().of(scene.split).collect();
    let mut categories: Vec<Category> = all.iter().map(|r| r.category).filter(|c| valid.contains(c)).collect();
    categories.sort_unstable();
    categories.dedup();
    let category = *categories.choose(rng)?;
    let mine: Vec<&ObjectRecord> = all.iter().copied().filter(|r| r.category == category).collect();
    let target = *mine.choose(rng)?;
    all.retain(|r| r.id != target.id);
    all.shuffle(rng);
    let [low, high] = scene.clutter.distractors;
    let wanted = rng.random_range(low..=high) as usize;
    let seconds = (0..2).filter(|_| rng.random_bool(SECOND_TARGET) || !strict).count();
    let mut choice = Choice { valid, chosen: vec![target], left: all, seconds, most: wanted + 1 };
    for (hosts, count) in needs(scene.clutter.style) {
        let there = usize::from(hosts.contains(&category));
        let needed = count.saturating_sub(there);
        let mut found = choice.take(needed, |r| hosts.contains(&r.category) && !valid.contains(&r.category), false);
        if found < needed {
            found += choice.take(needed - found, |r| hosts.contains(&r.category), false);
        }
        // A style without its host is none: where every host serves the verb, one more valid thing it is.
        if found + there == 0 {
            choice.take(1, |r| hosts.contains(&r.category), true);
        }
    }
    let near = |r: &ObjectRecord| !valid.contains(&r.category) && alike(r.category, category);
    let tall = |r: &ObjectRecord| !valid.contains(&r.category) && r.size_m[2] > TALL_M;
    let have = |choice: &Choice<'_, '_>, rule: &dyn Fn(&ObjectRecord) -> bool| {
        choice.chosen[1..].iter().filter(|r| rule(r)).count()
    };
    choice.take(NEAR.saturating_sub(have(&choice, &near)), near, false);
    choice.take(TALL.saturating_sub(have(&choice, &tall)), tall, false);
    choice.take(wanted, |_| true, false);
    Some(choice.chosen)
}

/// Things that are chosen and those that may still be.
struct Choice<'a, 'v> {
    valid: &'v [Category],
    chosen: Vec<&'a ObjectRecord>,
    left: Vec<&'a ObjectRecord>,
    /// Further valid things that may be among the distractors.
    seconds: usize,
    most: usize,
}

impl Choice<'_, '_> {
    /// Takes up to `count` things that satisfy `rule`; returns how many it found. `valid_too` takes
    /// valid things beyond those that are allowed.
    fn take(&mut self, count: usize, rule: impl Fn(&ObjectRecord) -> bool, valid_too: bool) -> usize {
        let count = count.min(self.most.saturating_sub(self.chosen.len()));
        let (before, mut i) = (self.chosen.len(), 0);
        while i < self.left.len() && self.chosen.len() < before + count {
            let second = self.valid.contains(&self.left[i].category);
            if !rule(self.left[i]) || (second && self.seconds == 0 && !valid_too) {
                i += 1;
                continue;
            }
            self.seconds = self.seconds.saturating_sub(usize::from(second));
            self.chosen.push(self.left.remove(i));
        }
        self.chosen.len() - before
    }
}

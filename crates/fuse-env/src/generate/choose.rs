//! Which things an episode is made of: a target for the verb, what the clutter style needs, near
//! misses, tall things that may hide the target, and others; from all categories.

use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::Validity;
use crate::catalogue::{Category, ObjectRecord};
use crate::configuration::{ClutterStyle, SceneConfiguration};
use crate::difficulty::Difficulty;
use crate::world::Stage;

/// Things that look or are handled alike: those of one kin are near misses of each other.
pub const KIN: &[&[Category]] = {
    use Category::*;
    &[
        &[Knife, ButterKnife, BoxCutter, Scissors, Spatula, Fork],
        &[Spoon, Ladle, Fork, ButterKnife, Whisk, Spatula, Chopsticks, Tongs, Sieve],
        &[Mug, Bowl, Pitcher, WaterBottle, Teapot, MeasuringCup, WineGlass, Can, Candle],
        &[Marker, Pen, Pencil, Chopsticks, Screwdriver, Flashlight],
        &[Hammer, Mallet, Screwdriver, Wrench, Pliers, RollingPin, Flashlight, Tongs],
        &[Sponge, Towel, Book, Eraser, ScrubBrush],
        &[Ruler, TapeMeasure, TapeDispenser, Stapler, BinderClip, BoxCutter, Eraser],
        &[Plate, Tray, Bowl, Colander, Book],
        &[Sieve, Colander, Grater, Ladle, Bowl],
    ]
};

fn kin(a: Category, b: Category) -> bool {
    KIN.iter().any(|group| group.contains(&a) && group.contains(&b))
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
    difficulty: &Difficulty,
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
    let [low, high] = difficulty.distractors.unwrap_or(scene.clutter.distractors);
    let wanted = rng.random_range(low..=high) as usize;
    let seconds = (0..2).filter(|_| rng.random_bool(difficulty.second_target) || !strict).count();
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
    let near = |r: &ObjectRecord| !valid.contains(&r.category) && kin(r.category, category);
    let tall = |r: &ObjectRecord| !valid.contains(&r.category) && r.size_m[2] >= difficulty.tall_from_m;
    let have = |choice: &Choice<'_, '_>, rule: &dyn Fn(&ObjectRecord) -> bool| {
        choice.chosen[1..].iter().filter(|r| rule(r)).count()
    };
    choice.take((difficulty.near_misses as usize).saturating_sub(have(&choice, &near)), near, false);
    choice.take((difficulty.tall_occluders as usize).saturating_sub(have(&choice, &tall)), tall, false);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_category_has_a_near_miss() {
        for a in Category::ALL {
            assert!(Category::ALL.iter().any(|b| a != b && kin(*a, *b)), "{a} stands alone");
        }
    }
}

//! Which things an episode is made of: a target for the verb, near misses, tall things that may hide
//! it, and others; of all categories.

use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::Validity;
use crate::catalogue::{Category, ObjectRecord};
use crate::configuration::SceneConfiguration;
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

/// A target and its distractors, the target first.
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
    let mut chosen = vec![target];
    let mut seconds = (0..2).filter(|_| rng.random_bool(difficulty.second_target) || !strict).count();
    let near = |r: &ObjectRecord| !valid.contains(&r.category) && kin(r.category, category);
    let tall = |r: &ObjectRecord| !valid.contains(&r.category) && r.size_m[2] >= difficulty.tall_from_m;
    for (rule, count) in [
        (&near as &dyn Fn(&ObjectRecord) -> bool, difficulty.near_misses as usize),
        (&tall, difficulty.tall_occluders as usize),
        (&|_: &ObjectRecord| true, wanted),
    ] {
        let mut left = count.min((wanted + 1).saturating_sub(chosen.len()));
        all.retain(|r| {
            let second = valid.contains(&r.category);
            if left == 0 || !rule(r) || (second && seconds == 0) {
                return true;
            }
            left -= 1;
            seconds -= usize::from(second);
            chosen.push(*r);
            false
        });
    }
    Some(chosen)
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

//! COLMAP's text files: a record a line, two for images; `#` begins a comment.

use std::str::FromStr;

use super::colmap::{Cameras, ImageRecord, Points, add_camera, pose, position};

/// cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS…
pub(super) fn cameras(bytes: &[u8]) -> Result<Cameras, String> {
    let mut cameras = Cameras::new();
    for (number, line) in records(text(bytes)?) {
        let at = |e: String| format!("line {number}: {e}");
        let mut words = Words::new(line);
        let id = words.next("camera number").map_err(at)?;
        let model: String = words.next("model").map_err(at)?;
        let size = [words.next("width").map_err(at)?, words.next("height").map_err(at)?];
        let params = words.rest("parameter").map_err(at)?;
        add_camera(&mut cameras, id, &model, size, &params).map_err(at)?;
    }
    Ok(cameras)
}

/// images.txt: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of observations, which may
/// be empty.
pub(super) fn images(bytes: &[u8]) -> Result<Vec<ImageRecord>, String> {
    let mut images = Vec::new();
    let mut lines = text(bytes)?.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        if is_empty(line) {
            continue;
        }
        let at = |e: String| format!("line {}: {e}", index + 1);
        let mut words = Words::new(line);
        words.next::<u32>("image number").map_err(at)?;
        let (rotation, translation) =
            (words.numbers("quaternion").map_err(at)?, words.numbers("translation").map_err(at)?);
        let camera = words.next("camera number").map_err(at)?;
        // Names may have spaces.
        let name = words.remainder().trim().to_owned();
        if name.is_empty() {
            return Err(at("the image's name is missing".into()));
        }
        let pose = pose(rotation, translation).map_err(|e| at(format!("image `{name}`: {e}")))?;
        images.push(ImageRecord { name, camera, pose });
        lines.next();
    }
    Ok(images)
}

/// points3D.txt: POINT3D_ID X Y Z R G B ERROR TRACK…
pub(super) fn points(bytes: &[u8]) -> Result<Points, String> {
    let (mut xyz, mut rgb) = (Vec::new(), Vec::new());
    for (number, line) in records(text(bytes)?) {
        let at = |e: String| format!("line {number}: {e}");
        let mut words = Words::new(line);
        words.next::<u64>("point number").map_err(at)?;
        xyz.push(words.numbers("position").and_then(position).map_err(at)?);
        let mut color = [0.0; 3];
        for c in &mut color {
            *c = f32::from(words.next::<u8>("colour").map_err(at)?) / 255.0;
        }
        rgb.push(color);
    }
    Ok((xyz, rgb))
}

fn text(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes).map_err(|e| format!("not text: byte {} is not UTF-8", e.valid_up_to()))
}

fn is_empty(line: &str) -> bool {
    let line = line.trim_start();
    line.is_empty() || line.starts_with('#')
}

/// Lines that hold something, with their numbers.
fn records(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().filter(|(_, l)| !is_empty(l)).map(|(i, l)| (i + 1, l))
}

/// The words of a line.
struct Words<'a>(&'a str);

impl<'a> Words<'a> {
    fn new(line: &'a str) -> Self {
        Self(line.trim())
    }

    fn word(&mut self) -> Option<&'a str> {
        let line = self.0.trim_start();
        let end = line.find(char::is_whitespace).unwrap_or(line.len());
        let (word, rest) = line.split_at(end);
        self.0 = rest;
        (!word.is_empty()).then_some(word)
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Result<T, String> {
        let word = self.word().ok_or_else(|| format!("{what} is missing"))?;
        word.parse().map_err(|_| format!("{what} `{word}` not understood"))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N], String> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.next(what)?;
        }
        Ok(out)
    }

    fn rest(&mut self, what: &str) -> Result<Vec<f64>, String> {
        let mut out = Vec::new();
        while let Some(word) = self.word() {
            out.push(word.parse().map_err(|_| format!("{what} `{word}` is not a number"))?);
        }
        Ok(out)
    }

    fn remainder(&self) -> &'a str {
        self.0
    }
}

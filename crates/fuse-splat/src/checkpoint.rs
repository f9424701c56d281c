//! The whole state of a training in one file, so that it continues bit for bit after a kill.
//!
//! Layout, little endian: `FUSESPLT`, version (u32), length of the header (u32), the header as JSON,
//! then for every Gaussian in turn 59 parameters, 59 first moments, 59 second moments (f32), then
//! the three statistics of densification, list by list (f32), last the CRC-32 of all before.
//! Views are not in it: they are added to a trainer again, and recognised by their checksums.

use std::path::Path;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng as _;
use serde::{Deserialize, Serialize};

use crate::bytes::Bytes;
use crate::constants::PARAMETERS;
use crate::order::Order;
use crate::stages::Density;
use crate::surgery::Patient;
use crate::table::Table;
use crate::{SplatError, Trainer, files};

const MAGIC: &[u8] = b"FUSESPLT";
const VERSION: u32 = 2;
/// f32 numbers of one Gaussian: parameters, two moments, three statistics.
const NUMBERS: usize = 3 * PARAMETERS + 3;

#[derive(Debug, Serialize, Deserialize)]
struct Header {
    iteration: u32,
    steps: u32,
    gaussians: usize,
    order: Order,
    densify_due: bool,
    reset_due: bool,
    rng_seed: [u8; 32],
    rng_stream: u64,
    /// 128 bits, which JSON numbers do not hold.
    rng_word: String,
    /// All settings, in words: compared, never parsed.
    config: String,
    /// [`Trainer::runs_on`].
    level: String,
    /// One line a view: camera and checksum of its image.
    views: Vec<String>,
    /// The caller's.
    note: String,
}

impl Trainer {
    /// Writes a checkpoint; the file appears whole or not at all. `note` is kept for the caller.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_checkpoint(&self, path: &Path, note: &str) -> Result<(), SplatError> {
        let header = Header {
            iteration: self.iteration,
            steps: self.steps,
            gaussians: self.patient.len(),
            order: self.order.clone(),
            densify_due: self.densify_due,
            reset_due: self.reset_due,
            rng_seed: self.rng.get_seed(),
            rng_stream: self.rng.get_stream(),
            rng_word: self.rng.get_word_pos().to_string(),
            config: format!("{:?}", self.config),
            level: self.runs_on(),
            views: self.view_lines(),
            note: note.into(),
        };
        let json = serde_json::to_vec(&header).map_err(|e| SplatError::file(path, e.to_string()))?;
        let length = u32::try_from(json.len()).map_err(|_| SplatError::file(path, "the header is too long"))?;
        let mut head = MAGIC.to_vec();
        head.extend(VERSION.to_le_bytes());
        head.extend(length.to_le_bytes());
        head.extend(json);
        let body = numbers(&self.patient);
        let mut crc = flate2::Crc::new();
        crc.update(&head);
        crc.update(&body);
        files::write(path, &[&head, &body, &crc.sum().to_le_bytes()])
    }

    /// Takes over the state of a checkpoint; returns its note. This trainer must have the settings,
    /// the SIMD level or GPU and the views, in their order, of the one that wrote it; its Gaussians are
    /// replaced.
    ///
    /// # Errors
    /// If the file is not a whole checkpoint, or one of the above differs; the trainer is then
    /// unchanged.
    pub fn load_checkpoint(&mut self, path: &Path) -> Result<String, SplatError> {
        let bytes = files::read(path)?;
        let fail = |what: String| SplatError::file(path, what);
        let (header, body) = parse(&bytes).map_err(fail)?;
        self.check_same(&header).map_err(fail)?;
        let word = header.rng_word.parse().map_err(|_| fail(format!("`{}` is no place", header.rng_word)))?;
        self.patient = patient(header.gaussians, body);
        let mut rng = ChaCha8Rng::from_seed(header.rng_seed);
        rng.set_stream(header.rng_stream);
        rng.set_word_pos(word);
        self.rng = rng;
        self.iteration = header.iteration;
        self.steps = header.steps;
        self.order = header.order;
        self.densify_due = header.densify_due;
        self.reset_due = header.reset_due;
        Ok(header.note)
    }

    /// The note of a checkpoint, whatever wrote it.
    ///
    /// # Errors
    /// If the file is not a whole checkpoint.
    pub fn checkpoint_note(path: &Path) -> Result<String, SplatError> {
        let bytes = files::read(path)?;
        let (header, _) = parse(&bytes).map_err(|what| SplatError::file(path, what))?;
        Ok(header.note)
    }

    fn check_same(&self, header: &Header) -> Result<(), String> {
        let config = format!("{:?}", self.config);
        if header.config != config {
            let (old, new) = first_difference(&header.config, &config);
            return Err(format!("written by a training with other settings: `{old}` there, `{new}` here"));
        }
        let here = self.runs_on();
        if header.level != here {
            return Err(format!(
                "written on {}, this training runs on {here}; it would not continue bit for bit",
                header.level
            ));
        }
        let views = self.view_lines();
        if header.views.len() != views.len() {
            return Err(format!("written with {} views, found {}", header.views.len(), views.len()));
        }
        if let Some(i) = (0..views.len()).find(|&i| views[i] != header.views[i]) {
            return Err(format!("written with other views: image or camera of view {i} differs"));
        }
        let counts = header.iteration.max(header.steps) > i32::MAX as u32;
        if !header.order.fits(views.len()) || counts {
            return Err("the header contradicts itself".into());
        }
        Ok(())
    }

    fn view_lines(&self) -> Vec<String> {
        self.views.iter().map(|shot| format!("{:08x} {:?}", shot.print, shot.camera)).collect()
    }
}

/// The first setting in which two lists of settings differ.
fn first_difference<'a>(a: &'a str, b: &'a str) -> (&'a str, &'a str) {
    a.split(", ").zip(b.split(", ")).find(|(x, y)| x != y).unwrap_or((a, b))
}

/// Checksum of an image's bytes.
pub(crate) fn print(image: &fuse_camera::RgbBuffer) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(image.as_slice().as_flattened());
    crc.sum()
}

fn numbers(patient: &Patient) -> Vec<u8> {
    let n = patient.len();
    let mut out = Vec::with_capacity(4 * NUMBERS * n);
    for i in 0..n {
        for table in [&patient.parameters, &patient.moments[0], &patient.moments[1]] {
            out.extend(table.vector(i).iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    let d = &patient.density;
    out.extend(d.gradient.iter().chain(&d.count).chain(&d.radius).flat_map(|v| v.to_le_bytes()));
    out
}

/// The header, and the numbers that follow it.
fn parse(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let mut b = Bytes::new(bytes);
    if b.take(MAGIC.len(), "the first bytes").ok() != Some(MAGIC) {
        return Err("not a checkpoint: it does not begin with `FUSESPLT`".into());
    }
    let version = b.u32("the version")?;
    if version != VERSION {
        return Err(format!("a checkpoint of version {version}, version {VERSION} is read"));
    }
    let length = b.u32("the header's length")?;
    let json = b.take(length as usize, "the header")?;
    let body = b.take(b.left().saturating_sub(4), "the numbers")?;
    let sum = b.u32("the checksum")?;
    let mut crc = flate2::Crc::new();
    crc.update(&bytes[..bytes.len() - 4]);
    if crc.sum() != sum {
        return Err("the checkpoint is damaged or truncated: its checksum does not fit".into());
    }
    let header: Header = serde_json::from_slice(json).map_err(|e| format!("header not understood: {e}"))?;
    if header.gaussians == 0 || header.gaussians.checked_mul(4 * NUMBERS) != Some(body.len()) {
        return Err(format!("{} Gaussians announced, found {} bytes", header.gaussians, body.len()));
    }
    Ok((header, body))
}

fn patient(n: usize, body: &[u8]) -> Patient {
    let values: Vec<f32> = body.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let (tables, statistics) = values.split_at(3 * PARAMETERS * n);
    let mut out = Patient::new(Table::default());
    let rows = tables.as_chunks::<PARAMETERS>().0;
    for vectors in rows.chunks_exact(3) {
        out.parameters.push(&vectors[0]);
        out.moments[0].push(&vectors[1]);
        out.moments[1].push(&vectors[2]);
    }
    let list = |k: usize| statistics[k * n..(k + 1) * n].to_vec();
    out.density = Density { gradient: list(0), count: list(1), radius: list(2) };
    out
}

use proptest::prelude::*;

use super::*;

/// The formula in f64, pixel by pixel, with nothing shared between neighbours.
fn reference(w: usize, h: usize, observed: &[[f64; 3]], rendered: &[[f64; 3]], options: &SsnrOptions) -> Vec<f64> {
    let reflected = |i: isize, n: usize| {
        let mut i = i;
        while n > 1 && (i < 0 || i >= n as isize) {
            i = if i < 0 { -i } else { 2 * (n as isize - 1) - i };
        }
        if n == 1 { 0 } else { i as usize }
    };
    let at = |x: isize, y: isize| reflected(y, h) * w + reflected(x, w);
    let gradient = |image: &[[f64; 3]], x: isize, y: isize| {
        let grey = |dx, dy| {
            let [r, g, b] = image[at(x + dx, y + dy)];
            (0.299 * r + 0.587 * g + 0.114 * b) * f64::from(options.gray_range)
        };
        let side = |dx| grey(dx, -1) + 2.0 * grey(dx, 0) + grey(dx, 1);
        let edge = |dy| grey(-1, dy) + 2.0 * grey(0, dy) + grey(1, dy);
        (side(1) - side(-1), edge(1) - edge(-1))
    };
    let (mut signal, mut noise) = (vec![0.0; w * h], vec![0.0; w * h]);
    for y in 0..h as isize {
        for x in 0..w as isize {
            let (ix, iy) = gradient(observed, x, y);
            let (rx, ry) = gradient(rendered, x, y);
            signal[at(x, y)] = ix * ix + iy * iy;
            noise[at(x, y)] = match options.gradient {
                Gradient::Magnitude => (ix.hypot(iy) - rx.hypot(ry)).powi(2),
                Gradient::Vector => (ix - rx).powi(2) + (iy - ry).powi(2),
            };
        }
    }
    let window = |field: &[f64], x: isize, y: isize| {
        (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dx, dy))).map(|(dx, dy)| field[at(x + dx, y + dy)]).sum::<f64>()
    };
    (0..w * h)
        .map(|i| {
            let (x, y) = ((i % w) as isize, (i / w) as isize);
            let ratio = (window(&signal, x, y) + EPSILON) / (window(&noise, x, y) + EPSILON);
            (10.0 * ratio.log10()).clamp(-30.0, 30.0)
        })
        .collect()
}

fn unit(image: &[[u8; 3]]) -> Vec<[f64; 3]> {
    image.iter().map(|p| p.map(|v| f64::from(v) / 255.0)).collect()
}

fn view(w: usize, h: usize, image: &[[u8; 3]]) -> View<'_, [u8; 3]> {
    View::new("observed", w as u32, h as u32, image).unwrap()
}

/// Reproducible noise in `0..=255`.
fn noise(seed: u64, n: usize) -> Vec<[u8; 3]> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut byte = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    };
    (0..n).map(|_| [byte(), byte(), byte()]).collect()
}

fn compared(w: usize, h: usize, observed: &[[u8; 3]], rendered: &[[u8; 3]], options: &SsnrOptions) -> Vec<f32> {
    let r = Rendered::U8(View::new("rendered", w as u32, h as u32, rendered).unwrap());
    ssnr(view(w, h, observed), Some(r), options).unwrap().into_vec()
}

fn largest_difference(a: &[f32], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - b).abs()).fold(0.0, f64::max)
}

#[test]
fn agrees_with_the_formula_on_noise_of_any_size() {
    for (w, h) in [(1, 1), (1, 9), (7, 2), (5, 5), (12, 13), (41, 23), (64, 97)] {
        for gradient in [Gradient::Magnitude, Gradient::Vector] {
            let options = SsnrOptions { gradient, ..Default::default() };
            let (a, b) = (noise(1, w * h), noise(2, w * h));
            let d =
                largest_difference(&compared(w, h, &a, &b, &options), &reference(w, h, &unit(&a), &unit(&b), &options));
            assert!(d < 2e-5, "{w}x{h} {gradient:?}: {d} dB");
        }
    }
}

#[test]
fn a_faint_texture_beside_a_hard_edge_keeps_its_digits() {
    // One level of blue, next to black against white: nine orders of magnitude in |∇I|².
    let (w, h) = (80, 40);
    let at = |i: usize, blue: u8| if i % w < 20 { [255 * (i as u8 & 1); 3] } else { [7, 7, 7 + blue] };
    let a: Vec<_> = (0..w * h).map(|i| at(i, u8::from(i * i % 7 == 1))).collect();
    let b: Vec<_> = (0..w * h).map(|i| at(i, u8::from(i * i % 5 == 1))).collect();
    let options = SsnrOptions::default();
    let d = largest_difference(&compared(w, h, &a, &b, &options), &reference(w, h, &unit(&a), &unit(&b), &options));
    assert!(d < 2e-5, "{d} dB");
}

#[test]
fn equal_images_and_flat_images_have_known_values() {
    let (w, h) = (30, 20);
    let a = noise(3, w * h);
    assert!(compared(w, h, &a, &a, &SsnrOptions::default()).iter().all(|&v| v == 30.0));
    // Flat against flat: 0 / 0, and ε makes it 0 dB.
    let (p, q) = (vec![[10, 200, 40]; w * h], vec![[255; 3]; w * h]);
    assert!(compared(w, h, &p, &q, &SsnrOptions::default()).iter().all(|&v| v == 0.0));
    // Flat observation, structured rendering: as bad as it gets.
    assert!(compared(w, h, &p, &a, &SsnrOptions::default()).iter().all(|&v| v == -30.0));
    // Structure against nothing: A = B.
    assert!(compared(w, h, &a, &p, &SsnrOptions::default()).iter().all(|&v| v.abs() < 1e-5));
}

#[test]
fn colours_of_one_grey_have_no_gradient_between_them() {
    let (w, h) = (24, 24);
    let pair = same_grey();
    let a: Vec<_> = (0..w * h).map(|i| pair[(i * 7 / 3) % 2]).collect();
    let flat = vec![pair[0]; w * h];
    assert!(compared(w, h, &flat, &a, &SsnrOptions::default()).iter().all(|&v| v == 0.0));
}

/// Two different colours with the same 299 r + 587 g + 114 b.
fn same_grey() -> [[u8; 3]; 2] {
    let grey = |p: [u8; 3]| 299 * u32::from(p[0]) + 587 * u32::from(p[1]) + 114 * u32::from(p[2]);
    let base = [120u8, 100, 100];
    for r in 0..=255u8 {
        for g in 0..=255u8 {
            let rest = i64::from(grey(base)) - i64::from(299 * u32::from(r) + 587 * u32::from(g));
            if r != base[0] && rest >= 0 && rest % 114 == 0 && rest / 114 <= 255 {
                return [base, [r, g, (rest / 114) as u8]];
            }
        }
    }
    unreachable!("the lattice of equal greys has such a point")
}

#[test]
fn a_missing_rendering_is_zero_decibels_and_uncertainty_four_tenths() {
    let image = noise(4, 12 * 15);
    let v = view(12, 15, &image);
    assert_eq!(ssnr(v, None, &SsnrOptions::default()).unwrap().into_vec(), [0.0; 180]);
    for normalization in [Normalization::Decibel, Normalization::Spatial] {
        let options = UncertaintyOptions { normalization, ..Default::default() };
        assert_eq!(geometric_uncertainty(v, None, &options).unwrap().into_vec(), [0.4; 180]);
    }
    let pessimist =
        UncertaintyOptions { ssnr: SsnrOptions { missing_db: -30.0, ..Default::default() }, ..Default::default() };
    assert_eq!(geometric_uncertainty(v, None, &pessimist).unwrap().into_vec(), [0.8; 180]);
}

#[test]
fn float_renderings_are_quantised_only_when_asked() {
    let (w, h) = (40, 30);
    let (a, b) = (noise(5, w * h), noise(6, w * h));
    // A third of a level off: rounding undoes it.
    let floats: Vec<[f32; 3]> = b.iter().map(|p| p.map(|v| (f32::from(v) + 0.33) / 255.0)).collect();
    let exact: Vec<[f64; 3]> = floats.iter().map(|p| p.map(f64::from)).collect();
    let options = SsnrOptions::default();
    let rendering = View::new("rendered", w as u32, h as u32, &floats).unwrap();
    let quantized = ssnr(view(w, h, &a), Some(Rendered::Quantized(rendering)), &options).unwrap();
    assert_eq!(quantized.as_slice(), compared(w, h, &a, &b, &options));
    let direct = ssnr(view(w, h, &a), Some(Rendered::F32(rendering)), &options).unwrap();
    let d = largest_difference(direct.as_slice(), &reference(w, h, &unit(&a), &exact, &options));
    assert!(d < 1e-4, "{d} dB");
    assert_ne!(direct.as_slice(), quantized.as_slice());
}

#[test]
fn grey_range_matters_only_against_epsilon() {
    let (w, h) = (30, 30);
    let faint = |i: usize, m| [9, 9, 9 + u8::from(i.is_multiple_of(m))];
    let (a, b): (Vec<_>, Vec<_>) = (0..w * h).map(|i| (faint(i, 97), faint(i, 89))).unzip();
    let values = |gray_range| {
        let options = SsnrOptions { gray_range, ..Default::default() };
        let ours = compared(w, h, &a, &b, &options);
        let d = largest_difference(&ours, &reference(w, h, &unit(&a), &unit(&b), &options));
        assert!(d < 2e-5, "{d} dB");
        ours
    };
    assert_ne!(values(1.0), values(0.001));
}

#[test]
fn spatial_normalisation_spans_the_whole_range() {
    let (w, h) = (40, 40);
    let (a, b) = (noise(7, w * h), noise(8, w * h));
    let rendered = Rendered::U8(view(w, h, &b));
    let options = UncertaintyOptions { normalization: Normalization::Spatial, ..Default::default() };
    let u = geometric_uncertainty(view(w, h, &a), Some(rendered), &options).unwrap().into_vec();
    let db = reference(w, h, &unit(&a), &unit(&b), &SsnrOptions::default());
    let ratios: Vec<f64> = db.iter().map(|d| 10f64.powf(d / 10.0)).collect();
    let (lo, hi) = ratios.iter().fold((f64::MAX, 0.0f64), |(l, h), &r| (l.min(r), h.max(r)));
    let expected: Vec<f64> = ratios.iter().map(|r| 0.8 * (1.0 - (r - lo) / (hi - lo))).collect();
    assert!(largest_difference(&u, &expected) < 1e-5);
    let flat = vec![[5; 3]; w * h];
    let u = geometric_uncertainty(view(w, h, &flat), Some(Rendered::U8(view(w, h, &flat))), &options).unwrap();
    assert!(u.as_slice().iter().all(|&v| v == 0.4));
}

#[test]
fn refuses_other_sizes_nan_and_bad_options() {
    let image = vec![[0u8; 3]; 12];
    let other = Rendered::U8(View::new("rendered", 3, 4, &image).unwrap());
    let text = |r: Rendered<'_>, o: SsnrOptions| ssnr(view(4, 3, &image), Some(r), &o).unwrap_err().to_string();
    assert_eq!(text(other, SsnrOptions::default()), "rendered must be 4x3 pixels like observed, found 3x4");
    let mut floats = vec![[0.5f32; 3]; 12];
    floats[4][1] = f32::NAN;
    for rendered in [Rendered::F32, Rendered::Quantized] {
        let r = rendered(View::new("rendered", 4, 3, &floats).unwrap());
        assert_eq!(text(r, SsnrOptions::default()), "rendered must be finite, found NaN at flat index 13");
    }
    let ok = Rendered::U8(view(4, 3, &image));
    assert_eq!(
        text(ok, SsnrOptions { gray_range: 0.0, ..Default::default() }),
        "gray_range must be positive and finite, found 0"
    );
    assert_eq!(
        text(ok, SsnrOptions { missing_db: 31.0, ..Default::default() }),
        "missing_db must be in [-30, 30] dB, found 31"
    );
}

fn images() -> impl Strategy<Value = (usize, usize, u64)> {
    (12usize..50, 12usize..140, any::<u64>())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn threads_never_change_a_bit((w, h, seed) in images()) {
        let (a, b) = (noise(seed, w * h), noise(seed ^ 99, w * h));
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| compared(w, h, &a, &b, &SsnrOptions::default()))
        };
        let one = with(1);
        for threads in [2, 3, 5] {
            prop_assert_eq!(&one, &with(threads));
        }
    }

    #[test]
    fn brightness_of_either_image_does_not_matter((w, h, seed) in images(), up in 0u8..=128, down in 0u8..=128) {
        let halved = |s| -> Vec<[u8; 3]> { noise(s, w * h).iter().map(|p| p.map(|v| v / 2)).collect() };
        let lifted = |image: &[[u8; 3]], by: u8| -> Vec<[u8; 3]> { image.iter().map(|p| p.map(|v| v + by)).collect() };
        let (a, b) = (halved(seed), halved(seed ^ 7));
        let plain = compared(w, h, &a, &b, &SsnrOptions::default());
        let shifted = compared(w, h, &lifted(&a, up), &lifted(&b, down), &SsnrOptions::default());
        prop_assert_eq!(plain, shifted);
    }

    #[test]
    fn mirroring_both_images_mirrors_the_result((w, h, seed) in images()) {
        let mirror = |v: &[[u8; 3]]| -> Vec<[u8; 3]> { (0..w * h).map(|i| v[i / w * w + (w - 1 - i % w)]).collect() };
        let (a, b) = (noise(seed, w * h), noise(seed ^ 3, w * h));
        let plain = compared(w, h, &a, &b, &SsnrOptions::default());
        let mirrored = compared(w, h, &mirror(&a), &mirror(&b), &SsnrOptions::default());
        for i in 0..w * h {
            let other = mirrored[i / w * w + (w - 1 - i % w)];
            prop_assert!((plain[i] - other).abs() < 1e-5);
        }
    }

    #[test]
    fn a_rendering_nearer_to_the_observation_is_never_less_certain((w, h, seed) in images()) {
        // R = k I with k < 1: |∇I| − |∇R| = (1 − k) |∇I|, so a larger k is better at each pixel.
        let a: Vec<[u8; 3]> = noise(seed, w * h).iter().map(|p| p.map(|v| v & 0xf8)).collect();
        let scaled = |shift: u32| -> Vec<[u8; 3]> { a.iter().map(|p| p.map(|v| v - (v >> shift))).collect() };
        let u = |rendered: &[[u8; 3]]| {
            let r = Rendered::U8(View::new("rendered", w as u32, h as u32, rendered).unwrap());
            geometric_uncertainty(view(w, h, &a), Some(r), &Default::default()).unwrap().into_vec()
        };
        for (near, far) in u(&scaled(3)).iter().zip(u(&scaled(1))) {
            prop_assert!(*near < far && (0.0..=0.8).contains(near) && (0.0..=0.8).contains(&far));
        }
    }
}

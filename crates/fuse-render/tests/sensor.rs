//! What the sensor makes of flat and rendered pictures, against its documented model.

mod common;

use fuse_camera::Buffer;
use fuse_render::{Frame, RenderOptions, Renderer, Sensor};

const W: u32 = 640;
const H: u32 = 480;

fn flat(byte: u8, depth: f32) -> Frame {
    Frame {
        rgb: Buffer::filled(W, H, [byte; 3]),
        depth: Buffer::filled(W, H, depth),
        instance: Buffer::filled(W, H, 3),
    }
}

fn exposed(sensor: &Sensor, frame: &Frame, view: u64) -> Frame {
    let mut out = frame.clone();
    sensor.expose(&mut out, view);
    out
}

fn rendered() -> Frame {
    let renderer = Renderer::new(common::tabletop(6, 24), &RenderOptions::default()).unwrap();
    renderer.render(&common::camera(W, H, [-0.2, -0.85, 1.4], [0.0, 0.0, 0.75]))
}

fn everything() -> Sensor {
    Sensor {
        seed: 0,
        exposure_stops: -0.3,
        exposure_jitter_stops: 0.2,
        defocus_px: 2.5,
        motion_px: 4.0,
        motion_deg: 30.0,
        shot_noise: 0.02,
        read_noise: 0.004,
        depth_noise_m: 0.001,
        depth_noise_per_m: 0.002,
        depth_edge_dropout: 0.5,
        depth_step_per_m: 0.003,
    }
}

fn linear(byte: u8) -> f64 {
    let v = f64::from(byte) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Mean and variance, and the standard error of the variance of as many normal numbers.
fn spread(values: impl Iterator<Item = f64>) -> (f64, f64, f64) {
    let v: Vec<f64> = values.collect();
    let n = v.len() as f64;
    let mean = v.iter().sum::<f64>() / n;
    let variance = v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, variance, variance * (2.0 / (n - 1.0)).sqrt())
}

#[test]
fn off_changes_no_byte_and_ids_never_change() {
    let frame = rendered();
    assert_eq!(exposed(&Sensor::default(), &frame, 9), frame);
    assert_eq!(exposed(&Sensor { seed: 5, motion_deg: 45.0, ..Sensor::default() }, &frame, 9), frame);
    let all = exposed(&everything(), &frame, 9);
    assert_eq!(all.instance, frame.instance);
    assert!(all.rgb != frame.rgb && all.depth != frame.depth);
    assert!(all.depth.as_slice().iter().all(|z| *z >= 0.0 && z.is_finite()));
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_other_bits_for_another_view() {
    let (frame, sensor) = (rendered(), everything());
    let on = |threads: usize, view: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| exposed(&sensor, &frame, view))
    };
    let one = on(1, 77);
    assert!(on(2, 77) == one && on(3, 77) == one && on(2, 77) == on(2, 77));
    let other = on(2, 78);
    assert!(other.rgb != one.rgb && other.depth != one.depth);
}

#[test]
fn color_noise_has_the_variance_of_the_model() {
    // Far from black and white, where clipping would take from it.
    for (byte, shot, read) in [(188, 0.04, 0.0), (188, 0.0, 0.03), (150, 0.05, 0.02), (110, 0.05, 0.01)] {
        let sensor = Sensor { shot_noise: shot, read_noise: read, ..Sensor::default() };
        let noisy = exposed(&sensor, &flat(byte, 1.0), 1);
        let light = linear(byte);
        let expected = f64::from(shot * shot) * light + f64::from(read * read);
        for channel in 0..3 {
            let (mean, found, error) = spread(noisy.rgb.as_slice().iter().map(|c| linear(c[channel])));
            // Bytes are told in steps: their variance comes on top.
            let step = (linear(byte + 1) - linear(byte - 1)) / 2.0;
            let expected = expected + step * step / 12.0;
            assert!((found - expected).abs() < 4.0 * error, "{byte} {shot} {read}: {found} for {expected} ± {error}");
            let error = (expected / f64::from(W * H)).sqrt();
            assert!((mean - light).abs() < 4.0 * error + 2e-4 * light, "{byte}: mean {mean} for {light}");
        }
    }
}

#[test]
fn channels_and_pixels_are_independent() {
    let noisy = exposed(&Sensor { read_noise: 0.03, ..Sensor::default() }, &flat(188, 1.0), 4);
    let light = |i: usize, c: usize| linear(noisy.rgb.as_slice()[i][c]) - linear(188);
    let n = (W * H) as usize - W as usize - 1;
    let against = |shift: usize, a: usize, b: usize| {
        let (mut ab, mut aa) = (0.0, 0.0);
        for i in 0..n {
            ab += light(i, a) * light(i + shift, b);
            aa += light(i, a).powi(2);
        }
        ab / aa * (n as f64).sqrt()
    };
    for (shift, a, b) in [(0, 0, 1), (0, 0, 2), (0, 1, 2), (1, 0, 0), (W as usize, 0, 0), (1, 2, 0)] {
        let found = against(shift, a, b);
        assert!(found.abs() < 4.0, "channels {a}, {b}, {shift} pixels on: {found} standard errors");
    }
}

#[test]
fn exposure_multiplies_linear_light_and_its_jitter_has_its_size() {
    for stops in [-2.0, -0.5, 1.0f32] {
        let out = exposed(&Sensor { exposure_stops: stops, ..Sensor::default() }, &flat(120, 1.0), 1);
        let (found, expected) = (linear(out.rgb.get(7, 9)[1]), linear(120) * f64::from(stops).exp2());
        let step = linear(out.rgb.get(7, 9)[1] + 1) - found;
        assert!((found - expected).abs() <= step / 2.0 * 1.05, "{stops} stops: {found} for {expected}");
    }
    let white = exposed(&Sensor { exposure_stops: 3.0, ..Sensor::default() }, &flat(200, 1.0), 1);
    assert_eq!(*white.rgb.get(0, 0), [255; 3]);
    let small = Frame {
        rgb: Buffer::filled(1, 1, [128; 3]),
        depth: Buffer::filled(1, 1, 1.0),
        instance: Buffer::filled(1, 1, 0),
    };
    let jitter = Sensor { exposure_jitter_stops: 0.5, ..Sensor::default() };
    let stops = (0..4000u64).map(|view| (linear(exposed(&jitter, &small, view).rgb.get(0, 0)[0]) / linear(128)).log2());
    let (mean, variance, error) = spread(stops);
    assert!(mean.abs() < 4.0 * 0.5 / 4000f64.sqrt(), "mean {mean}");
    // A little clipping at white is far out.
    assert!((variance - 0.25).abs() < 4.0 * error, "variance {variance} ± {error}");
}

#[test]
fn depth_noise_grows_as_the_model_says() {
    let sensor = Sensor { depth_noise_m: 0.0012, depth_noise_per_m: 0.0019, ..Sensor::default() };
    for z in [0.4, 0.8, 1.5, 3.0f32] {
        let noisy = exposed(&sensor, &flat(100, z), 2);
        let expected = (0.0012 + 0.0019 * f64::from(z * z)).powi(2);
        let (mean, found, error) = spread(noisy.depth.as_slice().iter().map(|z| f64::from(*z)));
        assert!((found - expected).abs() < 4.0 * error, "{z} m: variance {found} for {expected} ± {error}");
        assert!((mean - f64::from(z)).abs() < 4.0 * (expected / f64::from(W * H)).sqrt(), "{z} m: mean {mean}");
    }
    let mut holes = flat(0, 0.0);
    sensor.expose(&mut holes, 2);
    assert!(holes.depth.as_slice().iter().all(|z| *z == 0.0), "nothing was hit, nothing is measured");
}

#[test]
fn depth_is_told_in_steps_of_inverse_depth() {
    let sensor = Sensor { depth_step_per_m: 0.00285, ..Sensor::default() };
    for z in [0.4, 1.0, 2.7f32] {
        let told = f64::from(*exposed(&sensor, &flat(0, z), 0).depth.get(3, 3));
        let shift = 1.0 / (told * 0.00285);
        assert!((shift - shift.round()).abs() < 1e-3, "{z}: {shift} steps");
        assert!((1.0 / told - 1.0 / f64::from(z)).abs() <= 0.00285 / 2.0 * 1.001, "{z}: {told}");
    }
    // More than half a step from the first one: too far to be told.
    let coarse = Sensor { depth_step_per_m: 1.0, ..Sensor::default() };
    assert_eq!(*exposed(&coarse, &flat(0, 2.5), 0).depth.get(0, 0), 0.0);
}

#[test]
fn only_pixels_beside_a_jump_are_lost_and_as_many_as_asked_for() {
    let mut frame = flat(0, 0.0);
    // A steep plane (linear inverse depth), before it a card 20 cm nearer.
    for y in 0..H {
        for x in 0..W {
            let plane = 1.0 / (0.4 + 0.003 * y as f32);
            let card = (200..400).contains(&x) && (100..300).contains(&y);
            frame.depth.as_mut_slice()[(y * W + x) as usize] = if card { plane - 0.2 } else { plane };
        }
    }
    let lost = |chance: f32| {
        let out = exposed(&Sensor { depth_edge_dropout: chance, ..Sensor::default() }, &frame, 6);
        let (mut beside, mut elsewhere) = (0, 0);
        for y in 0..H {
            for x in 0..W {
                let at = |lo: u32, hi: u32, v: u32| v + 1 == lo || v == lo || v + 1 == hi || v == hi;
                let rim = (at(200, 400, x) && (100..300).contains(&y)) || (at(100, 300, y) && (200..400).contains(&x));
                let gone = u32::from(*out.depth.get(x, y) == 0.0);
                if rim { beside += gone } else { elsewhere += gone }
            }
        }
        (beside, elsewhere)
    };
    let rim = 4 * 200 * 2 - 4;
    assert_eq!(lost(1.0), (rim, 0));
    let (half, elsewhere) = lost(0.5);
    assert_eq!(elsewhere, 0);
    let error = (f64::from(rim) * 0.25).sqrt();
    assert!((f64::from(half) - f64::from(rim) / 2.0).abs() < 4.0 * error, "{half} of {rim}");
}

#[test]
fn blur_keeps_the_light_and_spreads_a_point_as_documented() {
    let mut frame = flat(0, 1.0);
    frame.rgb.as_mut_slice()[(240 * W + 320) as usize] = [255; 3];
    let moments = |sensor: Sensor| {
        let out = exposed(&sensor, &frame, 0);
        let (mut sum, mut xx, mut yy) = (0.0, 0.0, 0.0);
        for y in 0..H {
            for x in 0..W {
                let v = linear(out.rgb.get(x, y)[0]);
                sum += v;
                xx += v * (f64::from(x) - 320.0).powi(2);
                yy += v * (f64::from(y) - 240.0).powi(2);
            }
        }
        (sum, xx / sum, yy / sum)
    };
    let (sum, xx, yy) = moments(Sensor { defocus_px: 8.0, ..Sensor::default() });
    assert!((sum - 1.0).abs() < 0.02, "light {sum}");
    assert!((xx - 4.0).abs() < 0.3 && (yy - 4.0).abs() < 0.3, "a disc of 8: {xx}, {yy}");
    let (sum, xx, yy) = moments(Sensor { motion_px: 12.0, motion_deg: 90.0, ..Sensor::default() });
    assert!((sum - 1.0).abs() < 0.02 && xx == 0.0 && (yy - 12.0).abs() < 0.5, "a streak of 12 down: {xx}, {yy}");
    let plain = flat(77, 1.0);
    let blurred =
        exposed(&Sensor { defocus_px: 5.0, motion_px: 9.0, motion_deg: 20.0, ..Sensor::default() }, &plain, 0);
    assert_eq!(blurred.rgb, plain.rgb, "an even picture stays, to its edges");
}

#[test]
fn settings_out_of_range_are_named() {
    assert!(everything().check().is_ok() && Sensor::default().check().is_ok());
    let wrong = Sensor { shot_noise: -0.1, ..Sensor::default() };
    assert_eq!(wrong.check().unwrap_err().to_string(), "sensor: shot_noise must be from 0 to 1, found -0.1");
    let wrong = Sensor { depth_noise_m: f32::NAN, ..Sensor::default() };
    assert_eq!(wrong.check().unwrap_err().to_string(), "sensor: depth_noise_m must be from 0 to 1, found NaN");
    let wrong = Sensor { defocus_px: 17.0, ..Sensor::default() };
    assert_eq!(wrong.check().unwrap_err().to_string(), "sensor: defocus_px must be from 0 to 16, found 17");
}

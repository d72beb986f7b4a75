//! The parts of a filter yield the bits of the filter, even if each part is ahead of the next.

use plumbline_ahrs::{
    Ahrs, Attitude, Frame,
    parts::{CheckedSample, DeferredAttitude, Parts, SampleTime},
    stages::Fuser,
};

const DT_S: f64 = 0.01;
/// Samples by which each part is ahead of the next.
const CHUNK: usize = 64;

#[derive(Debug, Clone, Copy)]
struct Sample {
    rate_rad_s: [f64; 3],
    force_m_s2: [f64; 3],
    field_ut: Option<[f64; 3]>,
    dt_s: f64,
}

/// Returns samples of a body that turns and tilts.
///
/// The body also turns during outages of the gyro and during gaps. Some samples are repeated or
/// missing, and the magnetic field is disturbed for a time.
fn samples() -> Vec<Sample> {
    let sample = |count: u32| {
        let t_s = f64::from(count) * DT_S;
        let unobserved_rad = if count >= 2000 { 1.2 } else { 0.0 } + if count >= 4100 { 0.7 } else { 0.0 };
        let (sin, cos) = (0.3 * t_s.sin() + unobserved_rad).sin_cos();
        let disturbance_ut = if (2500..3200).contains(&count) { 30.0 } else { 0.0 };
        let is_missing = (1950..2000).contains(&count) || count % 977 < 3;
        Sample {
            rate_rad_s: if is_missing { [f64::NAN; 3] } else { [0.3 * t_s.cos(), 0.02, 0.4] },
            force_m_s2: [0.01 * t_s.cos(), 9.81 * sin, 9.81 * cos],
            field_ut: count.is_multiple_of(2).then_some([
                20.0 * (0.4 * t_s).sin() + disturbance_ut,
                20.0 * (0.4 * t_s).cos(),
                -40.0 + 1e-3 * t_s,
            ]),
            dt_s: match count {
                1200 => 0.15,
                4100 => 0.6,
                4700 => 2.5,
                _ if count % 613 == 5 => 0.0,
                _ if count % 619 == 7 => -3.0 * DT_S,
                _ => DT_S,
            },
        }
    };
    (0..6000).map(sample).collect()
}

fn snapshot(ahrs: &Ahrs<Fuser>) -> Vec<u8> {
    let mut bytes = vec![0; ahrs.snapshot_len()];
    ahrs.save(&mut bytes).unwrap();
    bytes
}

/// Returns the bits of an attitude in the frame of aircraft.
fn bits(attitude: &Attitude) -> Vec<u64> {
    let angles = attitude.angles();
    let [heading_sd_rad, inclination_sd_rad] = [attitude.heading_sd_rad(), attitude.inclination_sd_rad()];
    let numbers = attitude.quaternion_in(Frame::NedFrd).into_iter().chain(attitude.rate_rad_s_in(Frame::NedFrd));
    numbers
        .chain(attitude.gyro_bias_rad_s_in(Frame::NedFrd))
        .chain([angles.yaw_rad, angles.pitch_rad, angles.roll_rad, attitude.heading_rad()])
        .chain([heading_sd_rad, inclination_sd_rad])
        .map(f64::to_bits)
        .chain([attitude.flags().0, attitude.reset_counter(), attitude.tick()])
        .collect()
}

fn deferred_bits(attitude: &DeferredAttitude) -> Vec<u64> {
    let (angles, heading_rad) = attitude.angles().compute();
    let [heading_sd_rad, inclination_sd_rad] = [attitude.heading_sd_rad(), attitude.inclination_sd_rad()];
    let numbers = attitude.quaternion_in(Frame::NedFrd).into_iter().chain(attitude.rate_rad_s_in(Frame::NedFrd));
    numbers
        .chain(attitude.gyro_bias_rad_s_in(Frame::NedFrd))
        .chain([angles.yaw_rad, angles.pitch_rad, angles.roll_rad, heading_rad])
        .chain([heading_sd_rad, inclination_sd_rad])
        .map(f64::to_bits)
        .chain([attitude.flags().0, attitude.reset_counter(), attitude.tick()])
        .collect()
}

/// Processes the samples in chunks. Each part processes a whole chunk before the next part begins.
/// Returns the bits after each sample, and the number of samples that depend on the attitude.
fn process(ahrs: &mut Ahrs<Fuser>, samples: &[Sample]) -> (Vec<Vec<u64>>, usize) {
    let Parts { mut sensors, mut fusion } = ahrs.parts();
    let (mut found, mut dependent) = (Vec::new(), 0);
    let mut checked = [CheckedSample::default(); CHUNK];
    let mut outputs = [None; CHUNK];
    for chunk in samples.chunks(CHUNK) {
        // The parts of a sample that depends on the attitude cannot be ahead of each other.
        let mut rest = chunk;
        while !rest.is_empty() {
            let mut count = 0;
            let mut is_dependent = false;
            for (sample, checked) in rest.iter().zip(&mut checked) {
                let Sample { rate_rad_s, force_m_s2, field_ut, dt_s } = *sample;
                sensors.process(rate_rad_s, force_m_s2, field_ut, SampleTime::Interval { dt_s }, checked);
                count += 1;
                is_dependent = !checked.is_independent();
                if is_dependent {
                    break;
                }
            }
            let independent = &checked[..count - usize::from(is_dependent)];
            if let Some((mut aided, mut output)) = fusion.divide() {
                for (sample, output) in independent.iter().zip(&mut outputs) {
                    *output = aided.process(sample);
                }
                for (sample, aided) in independent.iter().zip(&outputs) {
                    found.push(deferred_bits(output.process(sample, aided.as_ref()).unwrap()));
                }
            } else {
                found.extend(independent.iter().map(|sample| deferred_bits(fusion.process(sample))));
            }
            if is_dependent {
                found.push(deferred_bits(fusion.process(&checked[count - 1])));
                dependent += 1;
            }
            rest = &rest[count..];
        }
    }
    fusion.finish();
    (found, dependent)
}

#[test]
fn parts_yield_the_bits_of_the_filter() {
    for stage in Fuser::NAMES {
        for course in ["angles", "track"] {
            let builder = || Ahrs::builder().fuser_stage(stage).unwrap().course_stage(course).unwrap();
            let build = || builder().declination_deg(3.0).unwrap().build();
            let (mut whole, mut divided) = (build(), build());
            let samples = samples();
            let update = |sample: &Sample| {
                let Sample { rate_rad_s, force_m_s2, field_ut, dt_s } = *sample;
                bits(&whole.update(rate_rad_s, force_m_s2, field_ut, dt_s))
            };
            let expected: Vec<_> = samples.iter().map(update).collect();
            let (found, dependent) = process(&mut divided, &samples);
            let first = found.iter().zip(&expected).position(|(found, expected)| found != expected);
            assert_eq!((first, found.len()), (None, expected.len()), "{stage}, {course}");
            assert_eq!(snapshot(&divided), snapshot(&whole), "{stage}, {course}");
            assert_eq!(divided.attitude(), whole.attitude());
            let counts = [dependent as u64, whole.rejected(), whole.attitude().reset_counter()];
            assert!(counts.iter().all(|count| *count > 1), "{stage}, {course}: {counts:?}");
        }
    }
}

#[test]
fn parts_without_a_sample_change_nothing() {
    let mut ahrs = Ahrs::<Fuser>::with_stage("multiple-model").unwrap();
    let (attitude, before) = (ahrs.attitude(), snapshot(&ahrs));
    ahrs.parts().fusion.finish();
    assert_eq!(ahrs.attitude(), attitude);
    assert_eq!(snapshot(&ahrs), before);
}

//! Tests the heading of `wz` in simulated magnetic fields: estimated sensor errors, convergence and
//! faults.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    angles::Angles,
    course::CourseReference,
    fuser::{Fused, FuserInput, wz::Wz},
    gyro::Motion,
    rotation::Rotation,
    stage::{RestoreError, Stage},
    state::{Attitude, wrapped_rad},
};

/// Simulated body that rotates in place after a rest, and its sensors.
#[derive(Clone, Copy)]
struct World {
    rate_hz: f64,
    /// Interval between magnetometer samples, in ticks.
    field_interval_ticks: u64,
    delay_s: f64,
    rest_s: f64,
    /// Speed of the movement relative to [`attitude_at`], which has a mean rate of 1.4 rad/s.
    speed_factor: f64,
    /// Magnetic field (east, north, up), µT.
    field_ut: [f64; 3],
    /// Drift rate of the gyro heading in motion, rad/s.
    drift_rad_s: f64,
}

const WORLD: World = World {
    rate_hz: 100.0,
    field_interval_ticks: 1,
    delay_s: 0.0,
    rest_s: 5.0,
    speed_factor: 1.0,
    field_ut: [0.0, 18.0, -42.0],
    drift_rad_s: 0.0,
};

/// Returns the attitude at `t_s` in a movement that repeats every minute.
fn attitude_at(t_s: f64) -> Attitude {
    let phase = t_s * core::f64::consts::TAU / 60.0;
    Attitude::from_angles(Angles {
        yaw_rad: 0.7 + 1.5 * (7.0 * phase).sin() - 0.4 * phase.sin(),
        pitch_rad: 0.9 * (5.0 * phase).sin(),
        roll_rad: 1.2 * (8.0 * phase).sin(),
    })
}

/// Returns approximately normal noise: the sum of twelve uniform numbers from a hash.
fn noise(tick: u64, axis: u64) -> f64 {
    let mut x = tick.wrapping_mul(3).wrapping_add(axis).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut sum = -6.0;
    for _ in 0..12 {
        x ^= x << 13;
        x ^= x >> 7;
        x ^= x << 17;
        sum += (x >> 11) as f64 / (1u64 << 53) as f64;
    }
    sum
}

impl World {
    fn attitude(&self, t_s: f64) -> Attitude {
        attitude_at(self.speed_factor * (t_s - self.rest_s).max(0.0))
    }

    fn input(&self, tick: u64) -> FuserInput {
        let (dt_s, t_s) = (1.0 / self.rate_hz, tick as f64 / self.rate_hz);
        let now = self.attitude(t_s);
        let rotation = if tick == 0 { Rotation::IDENTITY } else { Rotation::between(self.attitude(t_s - dt_s), now) };
        let q = rotation.quaternion();
        let q = if q.w < 0.0 { -q } else { q };
        let drift = if t_s > self.rest_s { now.up.direction() * self.drift_rad_s } else { Vector3::zeros() };
        let rate_rad_s = if tick == 0 { Vector3::zeros() } else { q.imag() * (2.0 / dt_s) + drift };
        let rotation = rotation.then(Rotation::from_rotation_vector(drift * dt_s));
        let dt_s = if tick == 0 { 0.0 } else { dt_s };
        let force_m_s2 = now.up.direction() * GRAVITY_M_S2;
        let [x, y, z] = self.field_ut;
        let field_ut = tick.is_multiple_of(self.field_interval_ticks).then(|| {
            let noise_ut = Vector3::from_fn(|axis, _| 0.5 * noise(tick, axis as u64));
            self.attitude(t_s - self.delay_s).matrix() * Vector3::new(x, y, z) + noise_ut
        });
        FuserInput {
            motion: Some(Motion { attitude: now, rotation, rate_rad_s, dt_s }),
            inclination: Some(Accelerometer::default().step(&force_m_s2)),
            field_ut,
            rest_credible: true,
            rate_credible: true,
            fix: None,
        }
    }

    /// Runs until `until_s` with inputs modified by `change`.
    ///
    /// After each tick, `observe` receives the time, the output, the heading error (rad) and the
    /// fuser.
    fn run(
        &self,
        fuser: &mut Wz,
        until_s: f64,
        change: impl Fn(f64, &mut FuserInput),
        mut observe: impl FnMut(f64, &Fused, f64, &Wz),
    ) {
        for tick in 0..(until_s * self.rate_hz) as u64 {
            let t_s = tick as f64 / self.rate_hz;
            let mut input = self.input(tick);
            change(t_s, &mut input);
            let out = fuser.step(&input);
            let e = out.attitude.quaternion() * self.attitude(t_s).quaternion().conjugate();
            observe(t_s, &out, wrapped_rad(2.0 * e.k.atan2(e.w)), fuser);
        }
    }
}

fn unchanged(_: f64, _: &mut FuserInput) {}

/// Returns the largest heading error from `from_s` onwards, in degrees.
fn max_error_deg(world: World, from_s: f64, until_s: f64, change: impl Fn(f64, &mut FuserInput)) -> f64 {
    let mut max_error = 0f64;
    world.run(&mut Wz::default(), until_s, change, |t_s, _, error, _| {
        max_error = max_error.max(if t_s >= from_s { error.to_degrees().abs() } else { 0.0 });
    });
    max_error
}

#[test]
fn heading_is_found_in_every_field_on_earth() {
    for strength_ut in [20.0, 70.0] {
        for dip_deg in [0f64, 60.0, -60.0, 80.0, -80.0] {
            let (sin, cos) = dip_deg.to_radians().sin_cos();
            let world = World { field_ut: [0.0, strength_ut * cos, -strength_ut * sin], ..WORLD };
            let max_error = max_error_deg(world, 30.0, 90.0, unchanged);
            println!("{strength_ut} µT, dip {dip_deg}°: {max_error:.2}°");
            assert!(max_error < 40.0 / (strength_ut * cos), "{strength_ut} µT, dip {dip_deg}°: {max_error}°");
        }
    }
}

#[test]
fn heading_holds_at_any_gyro_and_magnetometer_rate() {
    for (rate_hz, field_interval_ticks) in
        [(50.0, 1), (50.0, 5), (286.0, 1), (286.0, 29), (1000.0, 10), (8000.0, 80), (8000.0, 1)]
    {
        let world = World { rate_hz, field_interval_ticks, delay_s: 0.01, ..WORLD };
        let max_error = max_error_deg(world, 20.0, 40.0, unchanged);
        println!("{rate_hz} Hz, a field every {field_interval_ticks} ticks: {max_error:.2}°");
        assert!(max_error < 2.0, "{rate_hz} Hz, a field every {field_interval_ticks} ticks: {max_error}°");
    }
}

#[test]
fn delay_is_estimated_within_10_s_of_fast_rotation() {
    for delay_s in [-0.005, 0.013, 0.03] {
        let world = World { delay_s, rate_hz: 286.0, speed_factor: 3.0, ..WORLD };
        let mut estimated_s = f64::NAN;
        world.run(&mut Wz::default(), 15.0, unchanged, |_, _, _, fuser| estimated_s = fuser.magnetometer_delay_s());
        println!("delay {delay_s} s: estimated {estimated_s:.4} s");
        assert!((estimated_s - delay_s).abs() < 0.002, "delay {delay_s} s: estimated {estimated_s} s");
    }
}

#[test]
fn known_delay_is_kept() {
    let mut fuser = Wz::default();
    fuser.set("magnetometer_delay_s", 0.02).unwrap();
    fuser.set("magnetometer_delay_sd_s", 0.0).unwrap();
    WORLD.run(&mut fuser, 15.0, unchanged, |_, _, _, _| ());
    assert_eq!(fuser.magnetometer_delay_s(), 0.02);
}

#[test]
fn attached_magnet_is_estimated_within_5_s_of_rotation() {
    let magnet = Vector3::new(15.0, -20.0, 10.0);
    let attach = |t_s: f64, input: &mut FuserInput| {
        input.field_ut = input.field_ut.map(|field| if t_s >= 30.0 { field + magnet } else { field });
    };
    let (mut estimated_ut, mut max_error, mut aligned) = (Vector3::zeros(), 0f64, 0);
    WORLD.run(&mut Wz::default(), 60.0, attach, |t_s, out, error, fuser| {
        if t_s < 35.0 {
            estimated_ut = fuser.hard_iron_ut();
        }
        aligned += u32::from(out.corrections.aligned && t_s > 1.0);
        max_error = max_error.max(if t_s > 10.0 { error.to_degrees().abs() } else { 0.0 });
    });
    println!("magnet {magnet:?}: {estimated_ut:?}, largest heading error {max_error:.2}°, jumps {aligned}");
    assert!((estimated_ut - magnet).norm() < 3.0, "{estimated_ut:?}");
    assert!(max_error < 2.5, "{max_error}°");
}

#[test]
fn gyro_drift_is_corrected() {
    let world = World { drift_rad_s: 0.1f64.to_radians(), ..WORLD };
    let max_error = max_error_deg(world, 60.0, 600.0, unchanged);
    println!("0.1 °/s for 600 s: {max_error:.2}°");
    // The drift starts with the movement. It is nearly three times the bias error that remains
    // after a rest, so a large heading error is accepted.
    assert!(max_error < 2.5, "{max_error}°");
}

#[test]
fn heading_recovers_within_20_s_of_a_field_fault() {
    type Fault = fn(f64, &mut FuserInput);
    let faults: [(&str, Fault, f64); 6] = [
        ("no field", |_, input| input.field_ut = None, 2.0),
        ("stuck field", |_, input| input.field_ut = Some(Vector3::new(10.0, 20.0, -30.0)), 2.0),
        ("zero field", |_, input| input.field_ut = Some(Vector3::zeros()), 2.0),
        ("1e6 µT", |_, input| input.field_ut = Some(Vector3::new(1e6, -1e6, 1e6)), 2.0),
        ("1e300 µT", |_, input| input.field_ut = Some(Vector3::new(1e300, 0.0, -1e300)), 2.0),
        ("400 µT", |_, input| input.field_ut = Some(Vector3::new(300.0, 200.0, 100.0)), 2.0),
    ];
    for (name, fault, limit_deg) in faults {
        for (from_s, until_s) in [(30.0, 60.0), (0.0, 10.0)] {
            let change = |t_s: f64, input: &mut FuserInput| {
                if (from_s..until_s).contains(&t_s) {
                    fault(t_s, input);
                }
            };
            let max_error = max_error_deg(WORLD, until_s + 20.0, until_s + 60.0, change);
            println!("{name} from {from_s} s to {until_s} s: {max_error:.2}° from 20 s after it");
            assert!(max_error < limit_deg, "{name} from {from_s} s to {until_s} s: {max_error}°");
        }
    }
}

/// Returns the largest heading error, the longest time with an underestimated error, and the
/// output.
///
/// The largest error, in degrees, is that from `from_s` onwards. The time, in seconds, is the
/// longest for which the error exceeds three reported standard deviations. The output is that of
/// the last tick.
fn honest_errors(world: World, from_s: f64, until_s: f64, change: impl Fn(f64, &mut FuserInput)) -> (f64, f64, Fused) {
    let (mut max_error_deg, mut excess_s, mut longest_s, mut last) = (0f64, 0f64, 0f64, None);
    world.run(&mut Wz::default(), until_s, change, |t_s, out, error, _| {
        if t_s >= from_s {
            max_error_deg = max_error_deg.max(error.to_degrees().abs());
        }
        excess_s = if error.abs() > 3.0 * out.heading_sd_rad { excess_s + 1.0 / world.rate_hz } else { 0.0 };
        longest_s = longest_s.max(excess_s);
        last = Some(*out);
    });
    (max_error_deg, longest_s, last.unwrap())
}

#[test]
fn heading_recovers_after_start_beside_iron() {
    for iron_ut in [Vector3::new(25.0, 0.0, 5.0), Vector3::new(-20.0, -10.0, 15.0)] {
        let world = World { rest_s: 60.0, ..WORLD };
        let change = |t_s: f64, input: &mut FuserInput| {
            if t_s < world.rest_s {
                input.field_ut = input.field_ut.map(|field_ut| field_ut + world.attitude(t_s).matrix() * iron_ut);
            }
        };
        let (max_error_deg, excess_s, _) = honest_errors(world, 120.0, 240.0, change);
        println!("iron of {iron_ut:?} µT: {max_error_deg:.2}°, above three standard deviations for {excess_s:.1} s");
        assert!(max_error_deg < 5.0 && excess_s < 10.0, "{max_error_deg}°, {excess_s} s");
    }
}

#[test]
fn bias_step_in_motion_is_found() {
    for step_deg_s in [Vector3::new(1.5, -0.8, 1.0), Vector3::new(-4.0, 2.0, 0.0)] {
        let step_rad_s = step_deg_s.map(f64::to_radians);
        let change = |t_s: f64, input: &mut FuserInput| {
            if let Some(motion) = input.motion.as_mut().filter(|_| t_s > 60.0) {
                motion.rate_rad_s += step_rad_s;
                motion.rotation = motion.rotation.then(Rotation::from_rotation_vector(step_rad_s * motion.dt_s));
            }
        };
        let (max_error_deg, excess_s, last) = honest_errors(WORLD, 120.0, 300.0, change);
        let error_deg_s = (last.bias_rad_s - step_rad_s).amax().to_degrees();
        println!(
            "{step_deg_s:?} °/s: heading {max_error_deg:.2}°, above for {excess_s:.1} s, bias {error_deg_s:.3} °/s"
        );
        assert!(max_error_deg < 3.0 && excess_s < 10.0 && error_deg_s < 0.3, "{max_error_deg}°, {error_deg_s} °/s");
    }
}

#[test]
fn output_is_finite_for_any_finite_input() {
    let mut fuser = Wz::default();
    let extreme = |t_s: f64, input: &mut FuserInput| {
        let scale = [1e3, 1e10, 1e150, 1e300][t_s as usize % 4];
        if let Some(motion) = &mut input.motion {
            motion.rate_rad_s *= scale;
        }
        input.field_ut =
            input.field_ut.map(|field| if (t_s as usize).is_multiple_of(3) { field * scale } else { field * 5.0 });
    };
    WORLD.run(&mut fuser, 60.0, extreme, |t_s, out, _, _| {
        let finite =
            out.attitude.z_rad.is_finite() && out.attitude.up.w.re.is_finite() && out.heading_sd_rad.is_finite();
        assert!(finite, "{t_s} s: {out:?}");
    });
    fuser.clone().restore(&fuser.snapshot()).unwrap();
}

#[test]
fn heading_before_first_field_is_arbitrary() {
    let (mut with, mut without) = (Wz::default(), Wz::default());
    let none = |_: f64, input: &mut FuserInput| input.field_ut = None;
    WORLD.run(&mut without, 10.0, none, |_, out, _, _| {
        assert_eq!((out.reference, out.heading_sd_rad), (CourseReference::Arbitrary, core::f64::consts::PI));
    });
    let late = |t_s: f64, input: &mut FuserInput| input.field_ut = input.field_ut.filter(|_| t_s > 9.0);
    let mut aligned_s = Vec::new();
    WORLD.run(&mut with, 10.0, late, |t_s, out, _, _| {
        if out.corrections.aligned {
            aligned_s.push(t_s);
        }
        assert_eq!(out.reference == CourseReference::Magnetic, aligned_s.len() == 2, "{t_s} s");
    });
    assert!(aligned_s[0] == 0.0 && (9.0..9.3).contains(&aligned_s[1]), "{aligned_s:?}");
}

#[test]
fn adopted_magnetic_heading_does_not_jump() {
    let mut previous = Wz::default();
    WORLD.run(&mut previous, 20.0, unchanged, |_, _, _, _| ());
    let mut next = Wz::default();
    next.adopt(&previous.common()).unwrap();
    for tick in 2000..2600 {
        let out = next.step(&WORLD.input(tick));
        let e = out.attitude.quaternion() * WORLD.attitude(tick as f64 / 100.0).quaternion().conjugate();
        let error_deg = wrapped_rad(2.0 * e.k.atan2(e.w)).to_degrees();
        assert!(error_deg.abs() < 2.0 && !out.corrections.aligned, "tick {tick}: {error_deg}°");
        assert_eq!(out.reference, CourseReference::Magnetic);
    }
}

#[test]
fn restored_heading_continues_and_invalid_is_rejected() {
    let mut fuser = Wz::default();
    WORLD.run(&mut fuser, 12.34, unchanged, |_, _, _, _| ());
    let record = fuser.snapshot();
    let mut other = Wz::default();
    other.restore(&record).unwrap();
    for tick in 1234..2000 {
        let input = WORLD.input(tick);
        assert_eq!(fuser.step(&input), other.step(&input), "tick {tick}");
    }
    let mut rejected = 0;
    for index in 0..record.len {
        let mut invalid = record;
        invalid.values[index] = -1e3;
        invalid.checksum = invalid.compute_checksum();
        rejected += usize::from(matches!(Wz::default().restore(&invalid), Err(RestoreError::Invalid { .. })));
    }
    println!("{rejected} of {} values rejected at −1000", record.len);
    assert!(rejected > 200, "{rejected} of {}", record.len);
}

#[test]
fn heading_error_does_not_grow_over_a_day() {
    let minutes = if cfg!(debug_assertions) { 60 } else { 1440 };
    let world = World { rest_s: 0.0, ..WORLD };
    let inputs: Vec<_> = (0..6000).map(|tick| world.input(6000 + tick)).collect();
    let mut fuser = Wz::default();
    let mut max_error_deg = 0f64;
    for minute in 0..minutes {
        for (tick, input) in inputs.iter().enumerate() {
            let out = fuser.step(input);
            if minute > 0 && tick % 100 == 0 {
                let e = out.attitude.quaternion() * world.attitude(tick as f64 / 100.0).quaternion().conjugate();
                max_error_deg = max_error_deg.max(wrapped_rad(2.0 * e.k.atan2(e.w)).to_degrees().abs());
            }
        }
        if minute % 60 == 59 {
            fuser.clone().restore(&fuser.snapshot()).unwrap();
        }
    }
    println!("{minutes} minutes: largest heading error {max_error_deg:.2}°");
    assert!(max_error_deg < 1.5, "{max_error_deg}°");
}

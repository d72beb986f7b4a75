//! The heading of `wz` on simulated fields: what it learns, how soon, and what it survives.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Projector,
    angles::Angles,
    course::CourseReference,
    fuser::{Fused, FuserInput, wz::Wz},
    gyro::Motion,
    stage::{RestoreError, Stage},
    state::{Attitude, wrapped_rad},
    rotation::Rotation,
};

/// A body that turns in place after a rest, and its sensors.
#[derive(Clone, Copy)]
struct World {
    rate_hz: f64,
    /// Every so many ticks there is a field.
    field_every: u64,
    delay_s: f64,
    rest_s: f64,
    /// How much faster than [`attitude_at`] it turns; that is at 1.4 rad/s in the mean.
    pace: f64,
    /// East, north, up.
    field_ut: [f64; 3],
    /// By which the gyro's heading drifts in motion, rad/s.
    drift_rad_s: f64,
}

const WORLD: World = World {
    rate_hz: 100.0,
    field_every: 1,
    delay_s: 0.0,
    rest_s: 5.0,
    pace: 1.0,
    field_ut: [0.0, 18.0, -42.0],
    drift_rad_s: 0.0,
};

/// Yaw, pitch, roll with the period of a minute.
fn attitude_at(t_s: f64) -> Attitude {
    let phase = t_s * core::f64::consts::TAU / 60.0;
    Attitude::from_angles(Angles {
        yaw_rad: 0.7 + 1.5 * (7.0 * phase).sin() - 0.4 * phase.sin(),
        pitch_rad: 0.9 * (5.0 * phase).sin(),
        roll_rad: 1.2 * (8.0 * phase).sin(),
    })
}

/// A normal number of each tick and axis, twelve evens of a hash.
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
        attitude_at(self.pace * (t_s - self.rest_s).max(0.0))
    }

    fn input(&self, tick: u64) -> FuserInput {
        let (dt_s, t_s) = (1.0 / self.rate_hz, tick as f64 / self.rate_hz);
        let now = self.attitude(t_s);
        let turn = if tick == 0 { Rotation::IDENTITY } else { Rotation::between(self.attitude(t_s - dt_s), now) };
        let q = turn.quaternion();
        let q = if q.w < 0.0 { -q } else { q };
        let drift = if t_s > self.rest_s { now.up.direction() * self.drift_rad_s } else { Vector3::zeros() };
        let rate_rad_s = if tick == 0 { Vector3::zeros() } else { q.imag() * (2.0 / dt_s) + drift };
        let turn = turn.then(Rotation::from_rotation_vector(drift * dt_s));
        let dt_s = if tick == 0 { 0.0 } else { dt_s };
        let force_m_s2 = now.up.direction() * GRAVITY_M_S2;
        let [x, y, z] = self.field_ut;
        let field_ut = tick.is_multiple_of(self.field_every).then(|| {
            let sample = Vector3::from_fn(|axis, _| 0.5 * noise(tick, axis as u64));
            self.attitude(t_s - self.delay_s).matrix() * Vector3::new(x, y, z) + sample
        });
        FuserInput {
            motion: Some(Motion { attitude: now, rotation: turn, rate_rad_s, dt_s }),
            inclination: Some(Projector::default().step(&force_m_s2)),
            field_ut,
            rest_credible: true,
            rate_credible: true,
            fix: None,
        }
    }

    /// Runs to `until_s`, the inputs changed by `change`; hands each output and its heading error, rad, to `see`.
    fn run(
        &self,
        fuser: &mut Wz,
        until_s: f64,
        change: impl Fn(f64, &mut FuserInput),
        mut see: impl FnMut(f64, &Fused, f64, &Wz),
    ) {
        for tick in 0..(until_s * self.rate_hz) as u64 {
            let t_s = tick as f64 / self.rate_hz;
            let mut input = self.input(tick);
            change(t_s, &mut input);
            let out = fuser.step(&input);
            let e = out.attitude.quaternion() * self.attitude(t_s).quaternion().conjugate();
            see(t_s, &out, wrapped_rad(2.0 * e.k.atan2(e.w)), fuser);
        }
    }
}

fn as_it_is(_: f64, _: &mut FuserInput) {}

/// Largest heading error from a time on, degrees.
fn worst_deg(world: World, from_s: f64, until_s: f64, change: impl Fn(f64, &mut FuserInput)) -> f64 {
    let mut worst = 0f64;
    world.run(&mut Wz::default(), until_s, change, |t_s, _, error, _| {
        worst = worst.max(if t_s >= from_s { error.to_degrees().abs() } else { 0.0 });
    });
    worst
}

#[test]
fn heading_is_found_in_every_field_on_earth() {
    for strength_ut in [20.0, 70.0] {
        for dip_deg in [0f64, 60.0, -60.0, 80.0, -80.0] {
            let (sin, cos) = dip_deg.to_radians().sin_cos();
            let world = World { field_ut: [0.0, strength_ut * cos, -strength_ut * sin], ..WORLD };
            let worst = worst_deg(world, 30.0, 90.0, as_it_is);
            println!("{strength_ut} µT, dip {dip_deg}°: {worst:.2}°");
            assert!(worst < 40.0 / (strength_ut * cos), "{strength_ut} µT, dip {dip_deg}°: {worst}°");
        }
    }
}

#[test]
fn any_rate_of_gyro_and_magnetometer_will_do() {
    for (rate_hz, field_every) in
        [(50.0, 1), (50.0, 5), (286.0, 1), (286.0, 29), (1000.0, 10), (8000.0, 80), (8000.0, 1)]
    {
        let world = World { rate_hz, field_every, delay_s: 0.01, ..WORLD };
        let worst = worst_deg(world, 20.0, 40.0, as_it_is);
        println!("{rate_hz} Hz, a field every {field_every}: {worst:.2}°");
        assert!(worst < 2.0, "{rate_hz} Hz, a field every {field_every}: {worst}°");
    }
}

#[test]
fn the_delay_is_learnt_within_ten_seconds_of_fast_turning() {
    for delay_s in [-0.005, 0.013, 0.03] {
        let world = World { delay_s, rate_hz: 286.0, pace: 3.0, ..WORLD };
        let mut found_s = f64::NAN;
        world.run(&mut Wz::default(), 15.0, as_it_is, |_, _, _, fuser| found_s = fuser.magnetometer_delay_s());
        println!("delay {delay_s} s: found {found_s:.4} s");
        assert!((found_s - delay_s).abs() < 0.002, "delay {delay_s} s: found {found_s} s");
    }
}

#[test]
fn a_known_delay_stays() {
    let mut fuser = Wz::default();
    fuser.set("magnetometer_delay_s", 0.02).unwrap();
    fuser.set("magnetometer_delay_sd_s", 0.0).unwrap();
    WORLD.run(&mut fuser, 15.0, as_it_is, |_, _, _, _| ());
    assert_eq!(fuser.magnetometer_delay_s(), 0.02);
}

#[test]
fn a_magnet_put_on_the_body_is_known_within_five_seconds_of_turning() {
    let magnet = Vector3::new(15.0, -20.0, 10.0);
    let put_on = |t_s: f64, input: &mut FuserInput| {
        input.field_ut = input.field_ut.map(|field| if t_s >= 30.0 { field + magnet } else { field });
    };
    let (mut found_ut, mut worst, mut aligned) = (Vector3::zeros(), 0f64, 0);
    WORLD.run(&mut Wz::default(), 60.0, put_on, |t_s, out, error, fuser| {
        if t_s < 35.0 {
            found_ut = fuser.hard_iron_ut();
        }
        aligned += u32::from(out.corrections.aligned && t_s > 1.0);
        worst = worst.max(if t_s > 10.0 { error.to_degrees().abs() } else { 0.0 });
    });
    println!("magnet {magnet:?}: {found_ut:?}, worst heading {worst:.2}°, jumps {aligned}");
    assert!((found_ut - magnet).norm() < 3.0, "{found_ut:?}");
    assert!(worst < 2.5, "{worst}°");
}

#[test]
fn a_drift_of_the_gyro_is_taken_off() {
    let world = World { drift_rad_s: 0.1f64.to_radians(), ..WORLD };
    let worst = worst_deg(world, 60.0, 600.0, as_it_is);
    println!("0.1 °/s for 600 s: {worst:.2}°");
    // It begins with the movement, nearly three times what a rest leaves of it.
    assert!(worst < 2.5, "{worst}°");
}

#[test]
fn what_a_field_can_suffer_is_over_soon_after_its_end() {
    type Fault = fn(f64, &mut FuserInput);
    let faults: [(&str, Fault, f64); 6] = [
        ("no field", |_, input| input.field_ut = None, 2.0),
        ("a stuck field", |_, input| input.field_ut = Some(Vector3::new(10.0, 20.0, -30.0)), 2.0),
        ("no strength", |_, input| input.field_ut = Some(Vector3::zeros()), 2.0),
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
            let worst = worst_deg(WORLD, until_s + 20.0, until_s + 60.0, change);
            println!("{name} from {from_s} s to {until_s} s: {worst:.2}° from 20 s after it");
            assert!(worst < limit_deg, "{name} from {from_s} s to {until_s} s: {worst}°");
        }
    }
}

#[test]
fn the_output_stays_finite_for_any_finite_input() {
    let mut fuser = Wz::default();
    let absurd = |t_s: f64, input: &mut FuserInput| {
        let scale = [1e3, 1e10, 1e150, 1e300][t_s as usize % 4];
        if let Some(motion) = &mut input.motion {
            motion.rate_rad_s *= scale;
        }
        input.field_ut =
            input.field_ut.map(|field| if (t_s as usize).is_multiple_of(3) { field * scale } else { field * 5.0 });
    };
    WORLD.run(&mut fuser, 60.0, absurd, |t_s, out, _, _| {
        let finite =
            out.attitude.z_rad.is_finite() && out.attitude.up.w.re.is_finite() && out.heading_sd_rad.is_finite();
        assert!(finite, "{t_s} s: {out:?}");
    });
    fuser.clone().restore(&fuser.snapshot()).unwrap();
}

#[test]
fn before_the_first_field_the_heading_is_the_gyros() {
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
fn a_heading_that_was_magnetic_does_not_jump_when_it_is_taken_over() {
    let mut giver = Wz::default();
    WORLD.run(&mut giver, 20.0, as_it_is, |_, _, _, _| ());
    let mut taker = Wz::default();
    taker.adopt(&giver.common()).unwrap();
    for tick in 2000..2600 {
        let out = taker.step(&WORLD.input(tick));
        let e = out.attitude.quaternion() * WORLD.attitude(tick as f64 / 100.0).quaternion().conjugate();
        let error_deg = wrapped_rad(2.0 * e.k.atan2(e.w)).to_degrees();
        assert!(error_deg.abs() < 2.0 && !out.corrections.aligned, "tick {tick}: {error_deg}°");
        assert_eq!(out.reference, CourseReference::Magnetic);
    }
}

#[test]
fn a_restored_heading_goes_on_bit_for_bit_and_a_broken_one_is_refused() {
    let mut fuser = Wz::default();
    WORLD.run(&mut fuser, 12.34, as_it_is, |_, _, _, _| ());
    let record = fuser.snapshot();
    let mut other = Wz::default();
    other.restore(&record).unwrap();
    for tick in 1234..2000 {
        let input = WORLD.input(tick);
        assert_eq!(fuser.step(&input), other.step(&input), "tick {tick}");
    }
    let mut refused = 0;
    for index in 0..record.len {
        let mut broken = record;
        broken.values[index] = -1e3;
        broken.checksum = broken.compute_checksum();
        refused += usize::from(matches!(Wz::default().restore(&broken), Err(RestoreError::Invalid { .. })));
    }
    println!("{} numbers of state, {refused} of them refused at −1000", record.len);
    assert!(refused > 200, "{refused} of {}", record.len);
}

#[test]
fn a_day_changes_nothing() {
    let minutes = if cfg!(debug_assertions) { 60 } else { 1440 };
    let world = World { rest_s: 0.0, ..WORLD };
    let inputs: Vec<_> = (0..6000).map(|tick| world.input(6000 + tick)).collect();
    let mut fuser = Wz::default();
    let mut worst_deg = 0f64;
    for minute in 0..minutes {
        for (tick, input) in inputs.iter().enumerate() {
            let out = fuser.step(input);
            if minute > 0 && tick % 100 == 0 {
                let e = out.attitude.quaternion() * world.attitude(tick as f64 / 100.0).quaternion().conjugate();
                worst_deg = worst_deg.max(wrapped_rad(2.0 * e.k.atan2(e.w)).to_degrees().abs());
            }
        }
        if minute % 60 == 59 {
            fuser.clone().restore(&fuser.snapshot()).unwrap();
        }
    }
    println!("{minutes} minutes: worst {worst_deg:.2}°");
    assert!(worst_deg < 1.5, "{worst_deg}°");
}

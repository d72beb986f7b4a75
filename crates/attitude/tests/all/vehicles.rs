//! Fuser `wz` on accelerating and turning vehicles: no jumps without a flag, and errors compared
//! with the errors of VQF.
use attitude::{
    GRAVITY_M_S2, Quaternion, Vector3,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
    state::Attitude,
};
use scenario::{Motion, SensorErrors, Sensors};
use vqf_rs::VQF;

const DT_S: f64 = 0.01;
const GYRO_BIAS_RAD_S: f64 = 8.7e-4;
const MAX_JUMP_DEG: f64 = 1.0;

/// Acceleration over ground of a level vehicle during an interval.
struct Manoeuvre {
    name: &'static str,
    interval_s: [f64; 2],
    forward_m_s2: f64,
    left_m_s2: f64,
    yaw_rate_rad_s: f64,
}

const STRAIGHT: Manoeuvre =
    Manoeuvre { name: "", interval_s: [40.0, 40.0], forward_m_s2: 0.0, left_m_s2: 0.0, yaw_rate_rad_s: 0.0 };

const MANOEUVRES: [Manoeuvre; 6] = [
    Manoeuvre { name: "braking", interval_s: [40.0, 43.5], forward_m_s2: -8.0, ..STRAIGHT },
    Manoeuvre { name: "0 to 100 km/h", interval_s: [40.0, 49.0], forward_m_s2: 3.0, ..STRAIGHT },
    Manoeuvre { name: "lorry", interval_s: [40.0, 60.0], forward_m_s2: 1.0, ..STRAIGHT },
    Manoeuvre { name: "take-off", interval_s: [40.0, 60.0], forward_m_s2: 4.0, ..STRAIGHT },
    Manoeuvre { name: "bend", interval_s: [40.0, 80.0], left_m_s2: 2.0, yaw_rate_rad_s: 0.1, ..STRAIGHT },
    Manoeuvre { name: "roundabout", interval_s: [40.0, 70.0], left_m_s2: 4.0, yaw_rate_rad_s: 0.5, ..STRAIGHT },
];

/// Returns the inclination of an attitude. It is the inclination error if the vehicle is level.
fn inclination_deg(q: Quaternion<f64>) -> f64 {
    2.0 * q.i.hypot(q.j).atan2(q.w.hypot(q.k)).to_degrees()
}

fn step_deg(a: Attitude, b: Attitude) -> f64 {
    let q = a.quaternion() * b.quaternion().conjugate();
    inclination_deg(q)
}

#[test]
fn vehicle_manoeuvres_cause_no_unannounced_jump() {
    for Manoeuvre { name, interval_s: [from_s, to_s], forward_m_s2, left_m_s2, yaw_rate_rad_s } in MANOEUVRES {
        let mut noise = Sensors::new(Motion::S1, SensorErrors { accel_noise_m_s2: 0.05, ..SensorErrors::default() }, 1);
        let mut gyro = Gyro::from_name("mobius").unwrap();
        let (mut accel, mut fuser) = (Accelerometer::default(), Fuser::from_name("wz").unwrap());
        let mut vqf = VQF::new(DT_S, None, None, None);
        let (mut wz_deg, mut vqf_deg, mut previous) = (0.0_f64, 0.0_f64, Attitude::default());
        for tick in 0..16_000 {
            let t_s = f64::from(tick) * DT_S;
            let share = f64::from(u8::from((from_s..to_s).contains(&t_s)));
            let reading = noise.read(0.0);
            let force_m_s2 = reading.force_m_s2 - reading.truth.force_m_s2
                + Vector3::new(-left_m_s2 * share, forward_m_s2 * share, GRAVITY_M_S2);
            let rate_rad_s = Vector3::new(0.0, 0.0, yaw_rate_rad_s * share).add_scalar(GYRO_BIAS_RAD_S);
            let dt_s = if tick == 0 { 0.0 } else { DT_S };
            let fused = fuser.step(&FuserInput {
                motion: Some(gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Mean })),
                inclination: Some(accel.step(&force_m_s2)),
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            });
            vqf.update(rate_rad_s.into(), force_m_s2.into(), None);
            let q = vqf.quat_6d();
            wz_deg = wz_deg.max(inclination_deg(fused.attitude.quaternion()));
            vqf_deg = vqf_deg.max(inclination_deg(Quaternion::new(q.0, q.1, q.2, q.3)));
            let jump_deg = step_deg(fused.attitude, previous);
            assert!(jump_deg < MAX_JUMP_DEG || fused.corrections.aligned, "{name}: {jump_deg}° at {t_s} s");
            previous = fused.attitude;
        }
        println!("{name}: worst inclination error of wz {wz_deg:.1}°, of VQF {vqf_deg:.1}°");
        // The step response of `wz` may overshoot by a quarter of the step, much more than that of
        // the Butterworth filter in VQF.
        assert!(wz_deg < 1.35 * vqf_deg + 2.0, "{name}: {wz_deg}°, VQF {vqf_deg}°");
    }
}

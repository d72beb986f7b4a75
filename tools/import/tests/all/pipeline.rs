//! Attitudes that the default stages compute from imported logs, compared with those in the logs.

use attitude::{
    Quaternion,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    metrics::{Accuracy, AttitudeError},
    stage::Stage,
};

use crate::common::{Folder, log};

/// Maximum interval between two rows, s. Across a longer interval, the rate is not integrated.
const MAX_GAP_S: f64 = 0.1;

#[recorded::test]
fn default_stages_match_inclination_of_px4() {
    // The compass of the second log was not yet calibrated, so its heading limit is wider.
    for (name, rmse_deg, heading_deg) in [("px4_sample.ulg", 0.3, 1.5), ("px4_small.ulg", 0.2, 15.0)] {
        let Some(path) = log(name) else { return };
        let folder = Folder::new();
        let imported = folder.import(&[path], None).unwrap();
        let (mut gyro, mut accel) =
            (Gyro::from_name(Gyro::NAMES[0]).unwrap(), Accelerometer::from_name(Accelerometer::NAMES[0]).unwrap());
        let mut fuser = Fuser::from_name(Fuser::NAMES[0]).unwrap();
        let mut accuracy = Accuracy::default();
        let mut before_ns = None;
        for row in &imported.rows {
            let dt_s = before_ns.replace(row.t_ns).map_or(0.0, |before_ns: i64| (row.t_ns - before_ns) as f64 / 1e9);
            let rate =
                RateSample { rate_rad_s: row.rate_rad_s.into(), dt_s: dt_s.min(MAX_GAP_S), kind: RateKind::Mean };
            let fused = fuser.step(&FuserInput {
                motion: Some(gyro.step(&rate)),
                inclination: Some(accel.step(&row.force_m_s2.into())),
                field_ut: row.field_ut.map(Into::into),
                fix: None,
                rest_credible: true,
                rate_credible: true,
            });
            if let Some(reference) = row.reference {
                let [w, x, y, z] = reference.quaternion;
                accuracy.add(AttitudeError::between(fused.attitude.quaternion(), Quaternion::new(w, x, y, z)));
            }
        }
        let rmse = accuracy.rmse().unwrap();
        println!("{name}: {} rows compared, {rmse:?}, largest {:?}", accuracy.count(), accuracy.max);
        assert!(accuracy.count() > 1000 && rmse.inclination_deg < rmse_deg, "{rmse:?}");
        assert!(rmse.heading_deg < heading_deg, "{rmse:?}");
    }
}

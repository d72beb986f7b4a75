//! Tests that arbitrary samples do not cause a panic.

use judge::{InputCheck, TimestampCheck};
use messages::{Flags, Header, ImuSample, MagSample};
use proptest::prelude::*;

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), -50.0..50.0, Just(0.0), Just(f64::NAN), Just(f64::INFINITY), Just(f64::MAX)]
}

proptest! {
    #[test]
    fn arbitrary_samples_do_not_panic(
        rows in prop::collection::vec((any::<i64>(), any::<i64>(), any::<u64>(), prop::array::uniform9(number())), 1..40),
        repeats in 1..40,
    ) {
        let (mut check, mut stamps) = (InputCheck::default(), TimestampCheck::default());
        for _ in 0..repeats {
            for (t_start_ns, t_end_ns, flags, [gx, gy, gz, ax, ay, az, mx, my, mz]) in rows.iter().copied() {
                let flags = Flags(flags & !Flags::FAULT_INJECTED.0);
                let header = Header { t_start_ns, t_end_ns, flags, ..bytemuck::Zeroable::zeroed() };
                let imu = ImuSample { header, rate_rad_s: [gx, gy, gz], force_m_s2: [ax, ay, az] };
                check.update(&imu, Some(&MagSample { header, field_ut: [mx, my, mz] }));
                stamps.push(t_end_ns);
            }
        }
        for diagnosis in check.finish() {
            prop_assert_ne!(diagnosis.to_string(), "");
        }
    }
}

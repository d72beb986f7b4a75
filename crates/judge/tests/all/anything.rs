//! Whatever comes, nothing panics.

use judge::{Judge, Stamps};
use messages::{Flags, Header, ImuSample, MagSample};
use proptest::prelude::*;

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), -50.0..50.0, Just(0.0), Just(f64::NAN), Just(f64::INFINITY), Just(f64::MAX)]
}

proptest! {
    #[test]
    fn anything_is_judged_without_a_panic(
        rows in prop::collection::vec((any::<i64>(), any::<i64>(), any::<u64>(), prop::array::uniform9(number())), 1..40),
        repeats in 1..40,
    ) {
        let (mut judge, mut stamps) = (Judge::default(), Stamps::default());
        for _ in 0..repeats {
            for (t_start_ns, t_end_ns, flags, [gx, gy, gz, ax, ay, az, mx, my, mz]) in rows.iter().copied() {
                let flags = Flags(flags & !Flags::FAULT_INJECTED.0);
                let header = Header { t_start_ns, t_end_ns, flags, ..bytemuck::Zeroable::zeroed() };
                let imu = ImuSample { header, rate_rad_s: [gx, gy, gz], force_m_s2: [ax, ay, az] };
                judge.take(&imu, Some(&MagSample { header, field_ut: [mx, my, mz] }));
                stamps.take(t_end_ns);
            }
        }
        for finding in judge.finish() {
            prop_assert_ne!(finding.to_string(), "");
        }
    }
}

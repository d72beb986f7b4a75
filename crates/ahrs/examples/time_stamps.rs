//! Processes samples with timestamps, some of which are missing, repeated or late.
use plumbline_ahrs::{Ahrs, Flags};

fn main() {
    let mut ahrs = Ahrs::new();
    for count in 0..500_i64 {
        let t_ns = match count {
            200..240 => continue,            // 40 samples are missing.
            300 => (count - 1) * 10_000_000, // Another sample with the stamp of the previous one.
            400 => (count - 7) * 10_000_000, // A late sample.
            _ => count * 10_000_000,
        };
        let attitude =
            ahrs.update_at([0.0, 0.0, 1e-4 * (count % 7) as f64], [0.0, 1e-3 * (count % 5) as f64, 9.81], None, t_ns);
        let flags = attitude.flags();
        if flags.any(Flags::GAP | Flags::CLOCK_LEAP | Flags::REFUSED_BEFORE) {
            println!("sample {count}: {flags}");
        }
    }
    println!("{} samples rejected", ahrs.rejected());
}

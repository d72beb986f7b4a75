//! Prints the size of a filter and the number of instructions per update.
//!
//!     cargo run --release --bin cost [--features STAGE]
//!
//! Output, by semihosting: the stage, the size of the filter in bytes, and the mean and maximum
//! number of instructions per update over the sample recording.
//!
//! Time: the emulator executes one instruction per nanosecond, and the SysTick timer measures the
//! time. A loop of known length calibrates the timer.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use cortex_m::peripheral::{SYST, syst::SystClkSource};
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use panic_semihosting as _;
use plumbline_ahrs::{AhrsBuilder, attitude::stage::Stage as _};

/// Defines `fuser`, which creates the stage of the enabled feature. If no feature is enabled, it
/// creates the default stage.
macro_rules! stages {
    ($($feature:literal: $stage:ident, $create:ident,)*) => {
        $(#[cfg(feature = $feature)]
        fn fuser() -> plumbline_ahrs::stages::$stage {
            plumbline_ahrs::stages::$stage::$create()
        })*
        #[cfg(not(any($(feature = $feature),*)))]
        fn fuser() -> plumbline_ahrs::stages::MultipleModel {
            plumbline_ahrs::stages::MultipleModel::default()
        }
    };
}

stages! {
    "aided": Aided, default,
    "levelling": Levelling, default,
    "levelling-pi": LevellingPi, default,
    "levelling-unified": LevellingUnified, default,
    "madgwick": Madgwick, original,
    "madgwick-improved": Madgwick, improved,
    "vqf": Vqf, default,
    "wz": Wz, default,
    "wz-closed": WzClosed, default,
    "wz-open": WzOpen, default,
}

const SAMPLES: u64 = 3000;
/// Number of instructions executed for the calibration. The loop of `asm::delay` has two
/// instructions.
const CALIBRATION: u32 = 8_000_000;
const SYSTICK_MASK: u32 = 0x00ff_ffff;

/// Returns the SysTick counts that a call takes; at most 2²⁴ − 1.
fn counts(call: impl FnOnce()) -> u64 {
    let start = SYST::get_current();
    call();
    u64::from(start.wrapping_sub(SYST::get_current()) & SYSTICK_MASK)
}

#[entry]
fn main() -> ! {
    let Some(mut peripherals) = cortex_m::Peripherals::take() else { panic!("peripherals are in use") };
    peripherals.SYST.set_clock_source(SystClkSource::Core);
    peripherals.SYST.set_reload(SYSTICK_MASK);
    peripherals.SYST.clear_current();
    peripherals.SYST.enable_counter();
    let calibration = counts(|| cortex_m::asm::delay(CALIBRATION)).max(1);

    let mut ahrs = AhrsBuilder::new().fuser(fuser()).build();
    let (mut sum, mut max, mut samples) = (0, 0, 0);
    for sample in firmware::samples().take(SAMPLES as usize) {
        let taken = counts(|| {
            ahrs.update_at(sample.gyro_rad_s, sample.accel_m_s2, Some(sample.field_ut), sample.t_ns);
        });
        (sum, max, samples) = (sum + taken, taken.max(max), samples + 1);
    }
    let instructions = |counts: u64| counts * u64::from(CALIBRATION) / calibration;
    hprintln!(
        "{}: {} bytes, {} instructions per update, at most {}",
        ahrs.fuser().name(),
        size_of_val(&ahrs),
        instructions(sum) / samples,
        instructions(max)
    );
    debug::exit(debug::EXIT_SUCCESS);
    loop {}
}

//! The slot `accel`: reads `imu` and publishes the measured up direction of each tick on `accel`.
//!
//! Input: checked IMU samples.
//!
//! Output: the up direction as a point (u, v), and a trust value from 0 to 1.
//!
//! Failure: if the force is unusable, the previous point is repeated with trust 0 and a flag.

use attitude::{accel::Accelerometer, validated_stage::ValidatedStage};
use host::AnyStage;
use launch::Slot;
use messages::{AccelPoint, Flags, Header, ImuSample};
use runtime::{
    RuntimeError, ServiceConfig, SingleInputSlot, TickProcessor,
    convert::{chart_to_payload, complex_to_payload},
    stage,
};

/// Message processor of the slot `accel`.
#[derive(Debug)]
pub struct AccelProcessor(ValidatedStage<AnyStage<Accelerometer>>);

/// Creates the slot with the stage that `config` names.
///
/// # Errors
///
/// Returns an error if the stage cannot be built.
pub fn slot(config: &ServiceConfig) -> Result<SingleInputSlot<AccelProcessor>, RuntimeError> {
    let stage = ValidatedStage::new(stage::build_stage(Slot::Accel, &config.launch, Accelerometer::from_name)?);
    Ok(SingleInputSlot::new(AccelProcessor(stage)))
}

impl TickProcessor for AccelProcessor {
    const SLOT: Slot = Slot::Accel;

    type Input = ImuSample;
    type Output = AccelPoint;
    type Stage = AnyStage<Accelerometer>;

    fn process(&mut self, input: &ImuSample, mut header: Header) -> Option<AccelPoint> {
        let (inclination, was_reset) = self.0.step(&input.force_m_s2.into())?;
        header.flags |= Flags::RESET.when(was_reset) | inclination.flags();
        Some(AccelPoint {
            header,
            w: complex_to_payload(inclination.up.w),
            chart: chart_to_payload(inclination.up.chart),
            norm_m_s2: inclination.norm_m_s2,
            trust: inclination.trust,
            force_m_s2: input.force_m_s2,
        })
    }

    fn validated_stage(&self) -> &ValidatedStage<AnyStage<Accelerometer>> {
        &self.0
    }

    fn validated_stage_mut(&mut self) -> &mut ValidatedStage<AnyStage<Accelerometer>> {
        &mut self.0
    }

    fn visit_own_state(&mut self, _visit: &mut dyn FnMut(&mut u64)) {}
}

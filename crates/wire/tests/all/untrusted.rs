//! Bytes from anywhere are refused with what is wrong with them.
use crate::common::{Dice, Drawn, for_every_message};
use messages::{AttitudeOutput, Checkpoint, Credit, FusedState, ImuSample, SensorReading};
use prost::Message as _;
use wire::{
    BYTES_MAX, Payload, Refusal, Refusals, SAMPLES_MAX,
    command::ControlMessage,
    v1::{self, Envelope, SwapRequest},
};

fn attitude() -> AttitudeOutput {
    AttitudeOutput::drawn(&mut Dice::new(3))
}

fn refused(form: v1::AttitudeOutput) -> Refusal {
    AttitudeOutput::decoded(&form.encode_to_vec()).unwrap_err()
}

#[test]
fn a_field_that_is_not_there_is_named() {
    assert_eq!(AttitudeOutput::decoded(&[]), Err(Refusal::Missing { field: "header" }));
    let form = v1::AttitudeOutput { jump: None, ..attitude().form() };
    assert_eq!(refused(form), Refusal::Missing { field: "jump" });
}

#[test]
fn a_number_that_is_none_is_refused_but_where_it_may_be_unknown() {
    let form = v1::AttitudeOutput { yaw_rad: f64::NAN, ..attitude().form() };
    assert_eq!(refused(form), Refusal::NotFinite { field: "yaw_rad" });
    let mut sample = ImuSample::drawn(&mut Dice::new(1));
    sample.rate_rad_s[2] = f64::INFINITY;
    assert_eq!(ImuSample::decoded(&sample.encoded()), Err(Refusal::NotFinite { field: "rate_rad_s" }));
    let mut reading = SensorReading::drawn(&mut Dice::new(1));
    reading.rate_rad_s = [f64::NAN; 3];
    assert!(SensorReading::decoded(&reading.encoded()).is_ok());
}

#[test]
fn what_cannot_be_is_refused() {
    let out_of_range = |refusal: Refusal| match refusal {
        Refusal::OutOfRange { field, .. } => field,
        other => panic!("{other}"),
    };
    let long = v1::Quaternion { w: 1.0, x: 1.0, y: 0.0, z: 0.0 };
    assert_eq!(out_of_range(refused(v1::AttitudeOutput { quaternion: Some(long), ..attitude().form() })), "quaternion");
    for reference in [0, 4, -1, i32::MAX] {
        let form = v1::AttitudeOutput { course_reference: reference, ..attitude().form() };
        assert_eq!(out_of_range(refused(form)), "course_reference");
    }
    let header = v1::Header { t_start_ns: 2, t_end_ns: 1, ..v1::Header::default() };
    assert_eq!(out_of_range(refused(v1::AttitudeOutput { header: Some(header), ..attitude().form() })), "t_end_ns");
    let form = v1::FusedState { chart: 0, ..FusedState::drawn(&mut Dice::new(1)).form() };
    let checkpoint = v1::Checkpoint { stage: "w\0z".into(), service: 1, ..v1::Checkpoint::default() };
    assert_eq!(out_of_range(Checkpoint::decoded(&checkpoint.encode_to_vec()).unwrap_err()), "stage");
    assert_eq!(out_of_range(FusedState::decoded(&form.encode_to_vec()).unwrap_err()), "chart");
}

#[test]
fn more_than_there_may_be_is_refused() {
    assert_eq!(Credit::decoded(&vec![0; BYTES_MAX + 1]), Err(Refusal::TooLarge { bytes: BYTES_MAX + 1 }));
    let many = wire::seal(&Envelope::default(), &wire::samples(&vec![Credit { ticks: 1, ends: 0 }; SAMPLES_MAX + 1]));
    assert!(matches!(wire::open::<Credit>(&many), Err(Refusal::TooMany { .. })));
    let form =
        v1::Checkpoint { words: vec![1; messages::CHECKPOINT_WORDS + 1], service: 1, ..v1::Checkpoint::default() };
    assert!(matches!(Checkpoint::decoded(&form.encode_to_vec()), Err(Refusal::TooMany { what: "words", .. })));
    let form = v1::Checkpoint { stage: "s".repeat(33), service: 1, ..v1::Checkpoint::default() };
    assert!(matches!(Checkpoint::decoded(&form.encode_to_vec()), Err(Refusal::TooMany { what: "letters", .. })));
}

#[test]
fn a_request_that_says_too_little_is_refused() {
    let request = SwapRequest {
        request_id: "1".into(),
        slot: "fuser".into(),
        stage: "vqf".into(),
        expected_epoch: 1,
        t_deadline_ns: 1,
        ..SwapRequest::default()
    };
    let decoded = |request: &SwapRequest| SwapRequest::decoded(&request.encoded());
    assert_eq!(decoded(&request), Ok(request.clone()));
    for (wrong, field) in [
        (SwapRequest { request_id: String::new(), ..request.clone() }, "request_id"),
        (SwapRequest { slot: String::new(), ..request.clone() }, "slot"),
        (SwapRequest { stage: String::new(), ..request.clone() }, "stage"),
        (SwapRequest { expected_epoch: 0, ..request.clone() }, "expected_epoch"),
        (SwapRequest { t_deadline_ns: 0, ..request.clone() }, "t_deadline_ns"),
    ] {
        assert_eq!(decoded(&wrong), Err(Refusal::Missing { field }));
    }
    let long = SwapRequest { stage: "s".repeat(65), ..request.clone() };
    assert!(matches!(decoded(&long), Err(Refusal::OutOfRange { field: "stage", .. })));
    let set = [("beta_rad_s".to_owned(), f64::NAN)].into();
    assert_eq!(decoded(&SwapRequest { set, ..request }), Err(Refusal::NotFinite { field: "set" }));
}

#[test]
fn a_field_of_a_later_version_is_passed_over() {
    let mut bytes = wire::seal(&Envelope::default(), &wire::samples(&[Credit { ticks: 5, ends: 0 }]));
    // Field 15, three bytes.
    bytes.extend([0x7a, 3, 1, 2, 3]);
    assert_eq!(wire::open::<Credit>(&bytes).unwrap().1, [Credit { ticks: 5, ends: 0 }]);
}

#[test]
fn every_cut_of_every_message_is_answered_and_counted_by_kind() {
    let mut refusals = Refusals::default();
    let mut cuts = 0;
    fn cut<M: Drawn>(refusals: &mut Refusals, cuts: &mut u64) {
        let bytes = M::drawn(&mut Dice::new(5)).encoded();
        for end in 0..bytes.len().min(500) {
            *cuts += 1;
            if let Err(refusal) = M::decoded(&bytes[..end]) {
                refusals.count(&refusal);
            }
        }
    }
    for_every_message!(cut(&mut refusals, &mut cuts));
    assert!(refusals.total() > cuts / 2, "{refusals:?} of {cuts}");
    assert!(refusals.malformed > 0 && refusals.missing > 0, "{refusals:?}");
}

//! Untrusted bytes are rejected with a specific error.
use crate::common::{RandomMessage, TestRng, for_every_message};
use messages::{AttitudeOutput, Checkpoint, Credit, FusedState, ImuSample, SensorReading};
use prost::Message as _;
use wire::{
    DecodeError, DecodeErrorCounts, MAX_MESSAGE_BYTES, MAX_SAMPLES, Payload,
    command::ControlMessage,
    v1::{self, Envelope, SwapRequest},
};

fn attitude() -> AttitudeOutput {
    AttitudeOutput::random(&mut TestRng::new(3))
}

fn decode_error(message: v1::AttitudeOutput) -> DecodeError {
    AttitudeOutput::from_bytes(&message.encode_to_vec()).unwrap_err()
}

#[test]
fn missing_field_is_named() {
    assert_eq!(AttitudeOutput::from_bytes(&[]), Err(DecodeError::Missing { field: "header" }));
    let message = v1::AttitudeOutput { jump: None, ..attitude().to_proto() };
    assert_eq!(decode_error(message), DecodeError::Missing { field: "jump" });
}

#[test]
fn non_finite_value_is_rejected_unless_allowed() {
    let message = v1::AttitudeOutput { yaw_rad: f64::NAN, ..attitude().to_proto() };
    assert_eq!(decode_error(message), DecodeError::NotFinite { field: "yaw_rad" });
    let mut sample = ImuSample::random(&mut TestRng::new(1));
    sample.rate_rad_s[2] = f64::INFINITY;
    assert_eq!(ImuSample::from_bytes(&sample.to_bytes()), Err(DecodeError::NotFinite { field: "rate_rad_s" }));
    let mut reading = SensorReading::random(&mut TestRng::new(1));
    reading.rate_rad_s = [f64::NAN; 3];
    assert!(SensorReading::from_bytes(&reading.to_bytes()).is_ok());
}

#[test]
fn out_of_range_value_is_rejected() {
    let out_of_range = |error: DecodeError| match error {
        DecodeError::OutOfRange { field, .. } => field,
        other => panic!("{other}"),
    };
    let not_unit = v1::Quaternion { w: 1.0, x: 1.0, y: 0.0, z: 0.0 };
    assert_eq!(
        out_of_range(decode_error(v1::AttitudeOutput { quaternion: Some(not_unit), ..attitude().to_proto() })),
        "quaternion"
    );
    for reference in [0, 4, -1, i32::MAX] {
        let message = v1::AttitudeOutput { course_reference: reference, ..attitude().to_proto() };
        assert_eq!(out_of_range(decode_error(message)), "course_reference");
    }
    let header = v1::Header { t_start_ns: 2, t_end_ns: 1, ..v1::Header::default() };
    assert_eq!(
        out_of_range(decode_error(v1::AttitudeOutput { header: Some(header), ..attitude().to_proto() })),
        "t_end_ns"
    );
    let message = v1::FusedState { chart: 0, ..FusedState::random(&mut TestRng::new(1)).to_proto() };
    let checkpoint = v1::Checkpoint { stage: "w\0z".into(), service: 1, ..v1::Checkpoint::default() };
    assert_eq!(out_of_range(Checkpoint::from_bytes(&checkpoint.encode_to_vec()).unwrap_err()), "stage");
    assert_eq!(out_of_range(FusedState::from_bytes(&message.encode_to_vec()).unwrap_err()), "chart");
}

#[test]
fn excess_size_or_count_is_rejected() {
    assert_eq!(
        Credit::from_bytes(&vec![0; MAX_MESSAGE_BYTES + 1]),
        Err(DecodeError::TooLarge { bytes: MAX_MESSAGE_BYTES + 1 })
    );
    let many = wire::encode_batch(
        &Envelope::default(),
        &wire::encode_samples(&vec![Credit { ticks: 1, ends: 0 }; MAX_SAMPLES + 1]),
    );
    assert!(matches!(wire::decode_batch::<Credit>(&many), Err(DecodeError::TooMany { .. })));
    let message =
        v1::Checkpoint { words: vec![1; messages::CHECKPOINT_WORDS + 1], service: 1, ..v1::Checkpoint::default() };
    assert!(matches!(
        Checkpoint::from_bytes(&message.encode_to_vec()),
        Err(DecodeError::TooMany { what: "words", .. })
    ));
    let message = v1::Checkpoint { stage: "s".repeat(33), service: 1, ..v1::Checkpoint::default() };
    assert!(matches!(
        Checkpoint::from_bytes(&message.encode_to_vec()),
        Err(DecodeError::TooMany { what: "bytes", .. })
    ));
}

#[test]
fn incomplete_swap_request_is_rejected() {
    let request = SwapRequest {
        request_id: "1".into(),
        slot: "fuser".into(),
        stage: "vqf".into(),
        expected_epoch: 1,
        t_deadline_ns: 1,
        ..SwapRequest::default()
    };
    let decoded = |request: &SwapRequest| SwapRequest::from_bytes(&request.to_bytes());
    assert_eq!(decoded(&request), Ok(request.clone()));
    for (wrong, field) in [
        (SwapRequest { request_id: String::new(), ..request.clone() }, "request_id"),
        (SwapRequest { slot: String::new(), ..request.clone() }, "slot"),
        (SwapRequest { stage: String::new(), ..request.clone() }, "stage"),
        (SwapRequest { expected_epoch: 0, ..request.clone() }, "expected_epoch"),
        (SwapRequest { t_deadline_ns: 0, ..request.clone() }, "t_deadline_ns"),
    ] {
        assert_eq!(decoded(&wrong), Err(DecodeError::Missing { field }));
    }
    let long = SwapRequest { stage: "s".repeat(65), ..request.clone() };
    assert!(matches!(decoded(&long), Err(DecodeError::OutOfRange { field: "stage", .. })));
    let set = [("beta_rad_s".to_owned(), f64::NAN)].into();
    assert_eq!(decoded(&SwapRequest { set, ..request }), Err(DecodeError::NotFinite { field: "set" }));
}

#[test]
fn unknown_field_is_skipped() {
    let mut bytes = wire::encode_batch(&Envelope::default(), &wire::encode_samples(&[Credit { ticks: 5, ends: 0 }]));
    // Protobuf field 15 with a payload of three bytes.
    bytes.extend([0x7a, 3, 1, 2, 3]);
    assert_eq!(wire::decode_batch::<Credit>(&bytes).unwrap().1, [Credit { ticks: 5, ends: 0 }]);
}

#[test]
fn truncated_messages_are_rejected_and_counted() {
    let mut counts = DecodeErrorCounts::default();
    let mut cuts = 0;
    fn truncate<M: RandomMessage>(counts: &mut DecodeErrorCounts, cuts: &mut u64) {
        let bytes = M::random(&mut TestRng::new(5)).to_bytes();
        for end in 0..bytes.len().min(500) {
            *cuts += 1;
            if let Err(error) = M::from_bytes(&bytes[..end]) {
                counts.count(&error);
            }
        }
    }
    for_every_message!(truncate(&mut counts, &mut cuts));
    assert!(counts.total() > cuts / 2, "{counts:?} of {cuts}");
    assert!(counts.malformed > 0 && counts.missing > 0, "{counts:?}");
}

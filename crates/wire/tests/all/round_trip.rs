//! Encoding and then decoding a message reproduces it bit for bit.
use crate::common::{RandomMessage, TestRng, for_every_message};
use messages::Health;
use proptest::prelude::*;
use wire::{Payload as _, v1::Envelope};

/// Returns the bytes of a message, so that NaN compares equal to itself.
fn bits<M: messages::Message>(message: &M) -> Vec<u8> {
    bytemuck::bytes_of(message).to_vec()
}

fn check_message<M: RandomMessage>(seed: u64) {
    let message = M::random(&mut TestRng::new(seed));
    let decoded = M::from_bytes(&message.to_bytes()).unwrap();
    assert_eq!(bits(&decoded), bits(&message), "{} of seed {seed}: {decoded:?}", M::NAME);
}

fn check_batch<M: RandomMessage>(seed: u64, count: u64) {
    let mut rng = TestRng::new(seed);
    let messages: Vec<M> = (0..count).map(|_| M::random(&mut rng)).collect();
    let envelope = Envelope { sequence: rng.next_u64(), start_ns: rng.next_u64(), ..Envelope::default() };
    let bytes = wire::encode_batch(&envelope, &wire::encode_samples(&messages));
    let (decoded_envelope, decoded) = wire::decode_batch::<M>(&bytes).unwrap();
    assert_eq!(decoded_envelope, envelope);
    assert_eq!(decoded.iter().map(bits).collect::<Vec<_>>(), messages.iter().map(bits).collect::<Vec<_>>());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_message_round_trips(seed: u64) {
        for_every_message!(check_message(seed));
    }

    #[test]
    fn every_batch_round_trips(seed: u64, count in 0u64..9) {
        for_every_message!(check_batch(seed, count));
    }
}

#[test]
fn every_service_round_trips() {
    for service in graph::Service::ALL {
        let message = Health { service: service as u32, ..Health::random(&mut TestRng::new(1)) };
        let decoded = Health::from_bytes(&message.to_bytes()).unwrap();
        assert_eq!(decoded.service, service as u32, "{service}");
    }
}

#[test]
fn negative_zero_is_received_as_zero() {
    let sample = messages::ImuSample { rate_rad_s: [-0.0; 3], ..RandomMessage::random(&mut TestRng::new(1)) };
    let decoded = <messages::ImuSample as wire::Payload>::from_bytes(&wire::Payload::to_bytes(&sample)).unwrap();
    assert_eq!(decoded, sample);
    assert!(decoded.rate_rad_s.iter().all(|rate| rate.is_sign_positive()));
}

#[test]
fn full_batch_is_within_size_limit() {
    fn check<M: RandomMessage>() {
        let message = M::random(&mut TestRng::new(1));
        let capacity = wire::batch::capacity(message.to_bytes().len() + 8);
        let bytes =
            wire::encode_batch(&Envelope::default(), &wire::encode_samples(std::iter::repeat_n(&message, capacity)));
        assert!(bytes.len() <= wire::MAX_MESSAGE_BYTES, "{}: {} bytes", M::NAME, bytes.len());
        wire::decode_batch::<M>(&bytes).unwrap();
    }
    for_every_message!(check());
}

//! What goes out is what comes in, to the last bit.
use crate::common::{Dice, Drawn, for_every_message};
use proptest::prelude::*;
use wire::v1::Envelope;

/// Bits, so that NaN is equal to itself.
fn bits<M: messages::Message>(message: &M) -> Vec<u8> {
    bytemuck::bytes_of(message).to_vec()
}

fn alone<M: Drawn>(seed: u64) {
    let message = M::drawn(&mut Dice::new(seed));
    let back = M::decoded(&message.encoded()).unwrap();
    assert_eq!(bits(&back), bits(&message), "{} of seed {seed}: {back:?}", M::NAME);
}

fn in_a_batch<M: Drawn>(seed: u64, count: u64) {
    let mut dice = Dice::new(seed);
    let messages: Vec<M> = (0..count).map(|_| M::drawn(&mut dice)).collect();
    let envelope = Envelope { sequence: dice.word(), start_ns: dice.word(), ..Envelope::default() };
    let bytes = wire::seal(&envelope, &wire::samples(&messages));
    let (envelope_back, back) = wire::open::<M>(&bytes).unwrap();
    assert_eq!(envelope_back, envelope);
    assert_eq!(back.iter().map(bits).collect::<Vec<_>>(), messages.iter().map(bits).collect::<Vec<_>>());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_message_comes_back_as_it_was(seed: u64) {
        for_every_message!(alone(seed));
    }

    #[test]
    fn every_batch_comes_back_as_it_was(seed: u64, count in 0u64..9) {
        for_every_message!(in_a_batch(seed, count));
    }
}

#[test]
fn a_negative_zero_arrives_as_zero() {
    let sample = messages::ImuSample { rate_rad_s: [-0.0; 3], ..Drawn::drawn(&mut Dice::new(1)) };
    let back = <messages::ImuSample as wire::Payload>::decoded(&wire::Payload::encoded(&sample)).unwrap();
    assert_eq!(back, sample);
    assert!(back.rate_rad_s.iter().all(|rate| rate.is_sign_positive()));
}

#[test]
fn a_full_batch_is_within_the_limit() {
    fn full<M: Drawn>() {
        let message = M::drawn(&mut Dice::new(1));
        let room = wire::batch::room(message.encoded().len() + 8);
        let bytes = wire::seal(&Envelope::default(), &wire::samples(std::iter::repeat_n(&message, room)));
        assert!(bytes.len() <= wire::BYTES_MAX, "{}: {} bytes", M::NAME, bytes.len());
        wire::open::<M>(&bytes).unwrap();
    }
    for_every_message!(full());
}

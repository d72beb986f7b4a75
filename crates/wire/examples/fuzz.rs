//! Feeds mutated messages to every decoder: `cargo run --release -p wire --example fuzz -- 10000000
//! [SEED]`.
//!
//! Valid messages of every type are truncated, spliced, extended and rotated, and their bits and
//! bytes are changed. Each result is passed to one decoder. A message that is accepted must stay
//! the same when it is encoded and decoded again.
//!
//! Output: the number of accepted messages, and of errors by kind. A panic ends the run with an
//! error.
#![allow(clippy::unwrap_used, reason = "the fuzzer looks for panics")]

#[path = "../tests/all/common/mod.rs"]
mod common;

use std::time::Instant;

use common::{RandomMessage, TestRng, for_every_message};
use wire::{
    DecodeError, DecodeErrorCounts,
    command::ControlMessage,
    v1::{Envelope, GatewayReport, ServiceStatus, Services, SwapAnswer, SwapRequest},
};

/// Decoder under test. Returns `Ok` if it accepts the bytes.
type Decoder = fn(&[u8]) -> Result<(), DecodeError>;

fn decode_message<M: RandomMessage>(bytes: &[u8]) -> Result<(), DecodeError> {
    let accepted = M::from_bytes(bytes)?;
    let again = M::from_bytes(&accepted.to_bytes())?;
    // Compares bytes, because NaN is not equal to itself.
    assert!(again.to_bytes() == accepted.to_bytes(), "{}: {accepted:?} decoded again as {again:?}", M::NAME);
    Ok(())
}

fn decode_batch<M: RandomMessage>(bytes: &[u8]) -> Result<(), DecodeError> {
    wire::decode_batch::<M>(bytes).map(|(_, samples)| assert!(samples.len() <= wire::MAX_SAMPLES))
}

fn decode_control_message<L: ControlMessage>(bytes: &[u8]) -> Result<(), DecodeError> {
    L::from_bytes(bytes).map(drop)
}

/// Valid bytes and the decoder for their type.
type Seed = (Vec<u8>, Decoder);

fn corpus() -> Vec<Seed> {
    fn seeds<M: RandomMessage>() -> Vec<Seed> {
        let mut rng = TestRng::new(11);
        let messages: Vec<M> = (0..4).map(|_| M::random(&mut rng)).collect();
        let batch =
            wire::encode_batch(&Envelope { sequence: 1, ..Envelope::default() }, &wire::encode_samples(&messages));
        let single = messages.iter().map(|message| (message.to_bytes(), decode_message::<M> as Decoder));
        single.chain([(batch, decode_batch::<M> as Decoder)]).collect()
    }
    fn control<L: ControlMessage>(message: &L) -> Seed {
        (message.to_bytes(), decode_control_message::<L>)
    }
    let request = SwapRequest {
        request_id: "1".into(),
        slot: "fuser".into(),
        stage: "vqf".into(),
        set: [("beta_rad_s".to_owned(), 0.1)].into(),
        expected_epoch: 1,
        t_deadline_ns: 1,
    };
    let services =
        Services { t_now_ns: 1, services: vec![ServiceStatus { service: "fuser".into(), ..ServiceStatus::default() }] };
    let report = GatewayReport { envelope: Some(Envelope::default()), ..GatewayReport::default() };
    let answer = SwapAnswer { request_id: "1".into(), ..SwapAnswer::default() };
    let control_messages = [control(&request), control(&services), control(&report), control(&answer)];
    for_every_message!(seeds()).concat().into_iter().chain(control_messages).collect()
}

/// Picks a seed from the corpus at random and applies one to four mutations to it.
fn mutated(corpus: &[Seed], rng: &mut TestRng) -> Seed {
    let pick = |rng: &mut TestRng| &corpus[rng.below(corpus.len() as u64) as usize];
    // One in eight inputs is passed to the decoder of a randomly chosen type.
    let (mut bytes, own) = pick(rng).clone();
    let decoder = if rng.below(8) == 0 { pick(rng).1 } else { own };
    for _ in 0..=rng.below(4) {
        let position = |rng: &mut TestRng, bytes: &[u8]| rng.below(bytes.len() as u64 + 1) as usize;
        let at = position(rng, &bytes);
        match rng.below(7) {
            0 => bytes.truncate(at),
            1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << rng.below(8)),
            2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = rng.next_u64() as u8),
            3 => {
                bytes.truncate(at);
                let other = &pick(rng).0;
                bytes.extend_from_slice(&other[position(rng, other)..]);
            }
            // 0xff bytes yield huge lengths and unterminated varints.
            4 => drop(bytes.splice(at..at, std::iter::repeat_n(0xff, rng.below(11) as usize))),
            5 => drop(bytes.splice(at..at, (0..rng.below(9)).map(|i| (i * 37) as u8))),
            _ if rng.below(512) == 0 => {
                bytes.resize(wire::MAX_MESSAGE_BYTES + rng.below(2) as usize, rng.next_u64() as u8)
            }
            _ => bytes.rotate_left(at),
        }
    }
    (bytes, decoder)
}

fn main() {
    let mut arguments = std::env::args().skip(1).map(|argument| argument.parse::<u64>().unwrap());
    let (executions, seed) = (arguments.next().unwrap_or(1_000_000), arguments.next().unwrap_or(1));
    let (corpus, mut rng) = (corpus(), TestRng::new(seed));
    let (mut accepted, mut errors, start) = (0u64, DecodeErrorCounts::default(), Instant::now());
    for _ in 0..executions {
        let (bytes, decode) = mutated(&corpus, &mut rng);
        match decode(&bytes) {
            Ok(()) => accepted += 1,
            Err(error) => errors.count(&error),
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "{executions} executions of seed {seed}, {:.0}/s: {accepted} accepted, {} rejected",
        executions as f64 / seconds,
        errors.total()
    );
    println!("{errors:?}");
}

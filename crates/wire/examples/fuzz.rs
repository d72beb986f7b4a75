//! Hands damaged messages to every decoder: `cargo run --release -p wire --example fuzz -- 10000000 [SEED]`.
//!
//! A corpus of sound messages of every type is cut, joined, flipped, overwritten and lengthened; each result goes to one decoder. What
//! a decoder takes must come back the same when it is written and read again. Ends with the counts; a panic ends it with an error.
#![allow(clippy::unwrap_used, reason = "a panic is what is looked for")]

#[path = "../tests/all/common/mod.rs"]
mod common;

use std::time::Instant;

use common::{Dice, Drawn, for_every_message};
use wire::{
    Refusal, Refusals,
    command::ControlMessage,
    v1::{Envelope, GatewayReport, ServiceStatus, Services, SwapAnswer, SwapRequest},
};

/// Whether the bytes were taken.
type Decoder = fn(&[u8]) -> Result<(), Refusal>;

fn message<M: Drawn>(bytes: &[u8]) -> Result<(), Refusal> {
    let taken = M::decoded(bytes)?;
    let again = M::decoded(&taken.encoded())?;
    // As bytes, so that NaN is equal to itself.
    assert!(again.encoded() == taken.encoded(), "{}: {taken:?} came back as {again:?}", M::NAME);
    Ok(())
}

fn batch<M: Drawn>(bytes: &[u8]) -> Result<(), Refusal> {
    wire::open::<M>(bytes).map(|(_, samples)| assert!(samples.len() <= wire::SAMPLES_MAX))
}

fn letter<L: ControlMessage>(bytes: &[u8]) -> Result<(), Refusal> {
    L::decoded(bytes).map(drop)
}

/// Sound bytes with the decoder that takes them.
type Sound = (Vec<u8>, Decoder);

fn corpus() -> Vec<Sound> {
    fn of<M: Drawn>() -> Vec<Sound> {
        let mut dice = Dice::new(11);
        let messages: Vec<M> = (0..4).map(|_| M::drawn(&mut dice)).collect();
        let joined = wire::seal(&Envelope { sequence: 1, ..Envelope::default() }, &wire::samples(&messages));
        let alone = messages.iter().map(|sound| (sound.encoded(), message::<M> as Decoder));
        alone.chain([(joined, batch::<M> as Decoder)]).collect()
    }
    fn alone<L: ControlMessage>(sound: &L) -> Sound {
        (sound.encoded(), letter::<L>)
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
    let letters = [alone(&request), alone(&services), alone(&report), alone(&answer)];
    for_every_message!(of()).concat().into_iter().chain(letters).collect()
}

/// One to four damages.
fn damaged(corpus: &[Sound], dice: &mut Dice) -> Sound {
    let pick = |dice: &mut Dice| &corpus[dice.below(corpus.len() as u64) as usize];
    // Now and then to a decoder of another type.
    let (mut bytes, own) = pick(dice).clone();
    let decoder = if dice.below(8) == 0 { pick(dice).1 } else { own };
    for _ in 0..=dice.below(4) {
        let place = |dice: &mut Dice, bytes: &[u8]| dice.below(bytes.len() as u64 + 1) as usize;
        let at = place(dice, &bytes);
        match dice.below(7) {
            0 => bytes.truncate(at),
            1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << dice.below(8)),
            2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = dice.word() as u8),
            3 => {
                bytes.truncate(at);
                let other = &pick(dice).0;
                bytes.extend_from_slice(&other[place(dice, other)..]);
            }
            // A length or a number without end.
            4 => drop(bytes.splice(at..at, std::iter::repeat_n(0xff, dice.below(11) as usize))),
            5 => drop(bytes.splice(at..at, (0..dice.below(9)).map(|i| (i * 37) as u8))),
            _ if dice.below(512) == 0 => bytes.resize(wire::BYTES_MAX + dice.below(2) as usize, dice.word() as u8),
            _ => bytes.rotate_left(at),
        }
    }
    (bytes, decoder)
}

fn main() {
    let mut arguments = std::env::args().skip(1).map(|word| word.parse::<u64>().unwrap());
    let (executions, seed) = (arguments.next().unwrap_or(1_000_000), arguments.next().unwrap_or(1));
    let (corpus, mut dice) = (corpus(), Dice::new(seed));
    let (mut taken, mut refusals, start) = (0u64, Refusals::default(), Instant::now());
    for _ in 0..executions {
        let (bytes, decode) = damaged(&corpus, &mut dice);
        match decode(&bytes) {
            Ok(()) => taken += 1,
            Err(refusal) => refusals.count(&refusal),
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "{executions} executions of seed {seed}, {:.0}/s: {taken} taken, {} refused",
        executions as f64 / seconds,
        refusals.total()
    );
    println!("{refusals:?}");
}

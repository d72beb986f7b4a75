//! Instruction counts for encoding and decoding messages, measured with callgrind.
//!
//! Command: `cargo bench -p kernels --bench wire`.
//!
//! Input: 1000 messages in their bus layout, generated before counting starts.
//!
//! Output: the number of instructions (`Ir`) for 1000 messages, from payload to bytes (including
//! envelope and allocation) and from bytes to validated payloads.
//!
//! Failure: valgrind and gungraun-runner 0.20 are required.
#![allow(missing_docs, reason = "gungraun makes public modules of the functions and groups")]

mod examples;

use std::hint::black_box;

use gungraun::prelude::*;
use messages::{AttitudeOutput, FusedState, Health, ImuSample};
use wire::Payload;

use examples::{Example, envelope};

const MESSAGES: u64 = 1000;

#[library_benchmark]
#[bench::attitude(batches::<AttitudeOutput>(1))]
#[bench::attitude_batch_of_five(batches::<AttitudeOutput>(5))]
#[bench::fused(batches::<FusedState>(1))]
#[bench::imu(batches::<ImuSample>(1))]
#[bench::health(batches::<Health>(1))]
fn encode<M: Payload>(batches: Vec<Vec<M>>) -> Vec<Vec<M>> {
    for batch in &batches {
        black_box(wire::encode_batch(&envelope(), &wire::encode_samples(batch)));
    }
    batches
}

#[library_benchmark]
#[bench::attitude(encoded::<AttitudeOutput>(1))]
#[bench::attitude_batch_of_five(encoded::<AttitudeOutput>(5))]
#[bench::fused(encoded::<FusedState>(1))]
#[bench::imu(encoded::<ImuSample>(1))]
#[bench::health(encoded::<Health>(1))]
fn decode<M: Payload>(encoded: Encoded<M>) -> Encoded<M> {
    for bytes in &encoded.0 {
        black_box(wire::decode_batch::<M>(bytes).expect("the bytes were encoded here"));
    }
    encoded
}

library_benchmark_group!(name = messages_on_the_wire, benchmarks = [encode, decode]);
main!(library_benchmark_groups = messages_on_the_wire);

struct Encoded<M>(Vec<Vec<u8>>, std::marker::PhantomData<M>);

fn batches<M: Payload + Example>(samples: u64) -> Vec<Vec<M>> {
    (0..MESSAGES).map(|batch| (0..samples).map(|sample| M::example(batch * samples + sample)).collect()).collect()
}

fn encoded<M: Payload + Example>(samples: u64) -> Encoded<M> {
    let bytes = |batch: &Vec<M>| wire::encode_batch(&envelope(), &wire::encode_samples(batch));
    Encoded(batches(samples).iter().map(bytes).collect(), std::marker::PhantomData)
}

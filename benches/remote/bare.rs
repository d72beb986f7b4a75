//! Zenoh alone: a process puts bytes, another receives them, with the session settings of `link`.

use std::net::TcpListener;

use zenoh::{Config, Wait, bytes::Encoding, qos::CongestionControl};

use crate::{
    Cost, Failure, Variant, gateway,
    part::{self, End, Part, WAIT_LIMIT},
    watched,
};

const KEY: &str = "plumbline/v1/bench/attitude";

/// Measures the variant.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let at = format!("tcp/127.0.0.1:{}", free_port()?);
    let part = |end| Part::new(Variant::Zenoh, end, &at, rate_hz, seconds);
    let mut near = watched::start(&part(End::Near))?;
    let mut far = watched::start(&part(End::Far))?;
    watched::watch(&part(End::Far), &mut near, &[], &mut far)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    let opened = zenoh::open(config(part)?).wait();
    let session = opened.map_err(|error| format!("opening {}: {error}", part.at))?;
    match part.end {
        End::Near => {
            let encoding = Encoding::APPLICATION_PROTOBUF.with_schema("plumbline.v1.AttitudeOutputBatch");
            let declared =
                session.declare_publisher(KEY).encoding(encoding).congestion_control(CongestionControl::Drop);
            let publisher = declared.wait().map_err(|error| error.to_string())?;
            let mut bytes = vec![0x5a; gateway::message_bytes()];
            part::send(part, |tick, now_ns| {
                bytes[..8].copy_from_slice(&tick.to_le_bytes());
                bytes[8..16].copy_from_slice(&now_ns.to_le_bytes());
                publisher.put(bytes.as_slice()).wait().map_err(|error| error.to_string().into())
            })
        }
        End::Far => {
            let subscriber = session.declare_subscriber(KEY).wait().map_err(|error| error.to_string())?;
            part::receive(part, |take| {
                if let Some(sample) = subscriber.recv_timeout(WAIT_LIMIT).map_err(|error| error.to_string())? {
                    let bytes = sample.payload().to_bytes();
                    let word = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
                    take(word(0), word(8));
                }
                Ok(())
            })
        }
    }
}

fn config(part: &Part) -> Result<Config, Failure> {
    let mut config = Config::default();
    let end = if part.end == End::Near { "listen/endpoints" } else { "connect/endpoints" };
    let other = if part.end == End::Near { "connect/endpoints" } else { "listen/endpoints" };
    for (key, value) in [
        ("mode", "\"peer\""),
        (end, &format!("[\"{}\"]", part.at)),
        (other, "[]"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value).map_err(|error| format!("setting {key}: {error}"))?;
    }
    Ok(config)
}

/// A port that nobody has.
pub(crate) fn free_port() -> Result<u16, Failure> {
    Ok(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port())
}

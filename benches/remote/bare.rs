//! Variant `zenoh`: one process puts bytes, another receives them, with the session settings of
//! `link`.

use std::net::TcpListener;

use zenoh::{Config, Wait, bytes::Encoding, qos::CongestionControl};

use crate::{
    Cost, Failure, Variant, gateway, hop,
    hop_end::{self, End, MAX_WAIT, ProcessSettings},
};

const KEY: &str = "plumbline/v1/bench/attitude";

/// Measures the variant `zenoh`.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port()?);
    let settings = |end| ProcessSettings::new(Variant::Zenoh, end, &endpoint, rate_hz, seconds);
    let mut near = hop::start(&settings(End::Near))?;
    let mut far = hop::start(&settings(End::Far))?;
    hop::measure(&settings(End::Far), &mut near, &[], &mut far)
}

/// Runs one process of the variant `zenoh`.
pub(crate) fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    let result = zenoh::open(zenoh_config(settings)?).wait();
    let session = result.map_err(|error| format!("opening {}: {error}", settings.address))?;
    match settings.end {
        End::Near => {
            let encoding = Encoding::APPLICATION_PROTOBUF.with_schema("plumbline.v1.AttitudeOutputBatch");
            let declared =
                session.declare_publisher(KEY).encoding(encoding).congestion_control(CongestionControl::Drop);
            let publisher = declared.wait().map_err(|error| error.to_string())?;
            let mut bytes = vec![0x5a; gateway::message_bytes()];
            hop_end::send(settings, |tick, now_ns| {
                bytes[..8].copy_from_slice(&tick.to_le_bytes());
                bytes[8..16].copy_from_slice(&now_ns.to_le_bytes());
                publisher.put(bytes.as_slice()).wait().map_err(|error| error.to_string().into())
            })
        }
        End::Far => {
            let subscriber = session.declare_subscriber(KEY).wait().map_err(|error| error.to_string())?;
            hop_end::receive(settings, |record| {
                if let Some(sample) = subscriber.recv_timeout(MAX_WAIT).map_err(|error| error.to_string())? {
                    let bytes = sample.payload().to_bytes();
                    let word =
                        |offset: usize| u64::from_le_bytes(bytes[offset..offset + 8].try_into().expect("eight bytes"));
                    record(word(0), word(8));
                }
                Ok(())
            })
        }
    }
}

fn zenoh_config(settings: &ProcessSettings) -> Result<Config, Failure> {
    let mut config = Config::default();
    let end = if settings.end == End::Near { "listen/endpoints" } else { "connect/endpoints" };
    let other = if settings.end == End::Near { "connect/endpoints" } else { "listen/endpoints" };
    for (key, value) in [
        ("mode", "\"peer\""),
        (end, &format!("[\"{}\"]", settings.address)),
        (other, "[]"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value).map_err(|error| format!("setting {key}: {error}"))?;
    }
    Ok(config)
}

/// Returns a free TCP port.
pub(crate) fn free_port() -> Result<u16, Failure> {
    Ok(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port())
}

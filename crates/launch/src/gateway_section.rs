//! Keys of `[gateway]`.

use std::collections::BTreeMap;

use graph::{Buffer, Entry, Topic};

use crate::{
    endpoint,
    gateway::{Gateway, Tls, TopicRate},
    model::system_name,
    split,
    toml_reader::Section,
};

/// Reads `[gateway]`.
pub(crate) fn gateway(section: &mut Section<'_, '_>, out: &mut Gateway) {
    let name = |name: &str| system_name(name).map(Some);
    section.parsed("vehicle", r#"1 to 32 of a-z, 0-9, "_" and "-""#, name, &mut out.vehicle);
    section.number("messages_hz", 20.0..=10_000.0, &mut out.messages_hz);
    section.parsed("access", "a path", |path| Some(Some(path.into())), &mut out.access);
    section.section("tls", |section| {
        let mut tls = Tls::default();
        let files = [("ca", &mut tls.ca), ("cert", &mut tls.cert), ("key", &mut tls.key)];
        let valid = files.map(|(key, file)| section.parsed(key, "a path", |path| Some(path.into()), file));
        let missing = ["ca", "cert", "key"].into_iter().find(|key| !section.has(key));
        match missing {
            Some(key) => {
                section.report_table(&format!("gateway.tls: {key:?} is missing"), "mutual TLS needs ca, cert and key")
            }
            None if valid.iter().all(|valid| *valid) => out.tls = Some(tls),
            None => {}
        }
    });
    section.section("rates", |section| {
        for topic in Topic::ALL {
            rate(section, topic.entry(), &mut out.rates);
        }
    });
    split::split_keys(section, out);
    endpoint::endpoints(section, out);
}

fn rate(section: &mut Section<'_, '_>, topic: &'static Entry, rates: &mut BTreeMap<String, TopicRate>) {
    let mut hz = 0.0;
    let mut value = None;
    // Topics outside the data path are not timed by the source, so their rate cannot be reduced.
    let is_untimed = topic.buffer == Buffer::Control;
    let topic = topic.name;
    if section.is_number(topic) && !is_untimed {
        if section.number(topic, 0.1..=10_000.0, &mut hz) {
            rates.insert(topic.into(), TopicRate::Hz(hz));
        }
        return;
    }
    let expected = if is_untimed { r#""all" or "off""# } else { r#""all", "off" or a number of Hz"# };
    let accept = |text: &str| ["all", "off"].contains(&text).then(|| Some(text.to_owned()));
    if section.parsed(topic, expected, accept, &mut value) {
        match value.as_deref() {
            Some("all") => drop(rates.insert(topic.into(), TopicRate::All)),
            Some(_) => drop(rates.remove(topic)),
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    fn rejected(text: &str) -> String {
        Launch::parse("launch.toml", text)
            .map(|launch| panic!("{:?} was accepted", launch.gateway))
            .unwrap_or_else(|problems| problems.to_string())
    }

    #[test]
    fn every_key_of_the_gateway_is_read() {
        let text = r#"
            services = ["ingest", "gyro", "accel", "fuser", "course", "gateway"]
            [gateway]
            vehicle = "drone-7"
            listen = ["tcp/localhost:7447", "tcp/[::1]:1", "quic/0.0.0.0:7447", "quic/[::]:7448"]
            connect = ["quic/station.example:7447"]
            messages_hz = 50
            access = "access.json5"
            tls = { ca = "ca.pem", cert = "me.pem", key = "me.key" }
            [gateway.rates]
            attitude = "all"
            fused = "off"
            imu = 100
        "#;
        let gateway = Launch::parse("launch.toml", text).unwrap().gateway;
        assert_eq!(gateway.vehicle.as_deref(), Some("drone-7"));
        assert_eq!((gateway.listen.len(), gateway.connect.len(), gateway.messages_hz), (4, 1, 50.0));
        assert_eq!(gateway.tls, Some(Tls { ca: "ca.pem".into(), cert: "me.pem".into(), key: "me.key".into() }));
        let rate = |topic: &str| gateway.rates.get(topic).copied();
        assert_eq!(
            (rate("attitude"), rate("fused"), rate("imu")),
            (Some(TopicRate::All), None, Some(TopicRate::Hz(100.0)))
        );
        assert_eq!(rate("health"), Some(TopicRate::All), "a missing key keeps its default");
    }

    #[test]
    fn insecure_or_invalid_endpoint_is_rejected_with_remedy() {
        for (text, expected) in [
            ("listen = [\"tcp/0.0.0.0:7447\"]", "outside the loopback only mutual TLS"),
            ("listen = [\"tcp/127.0.0.1:7447\", \"tcp/192.168.1.4:7447\"]", "\"tcp/192.168.1.4:7447\" is not secured"),
            ("connect = [\"tcp/station.example:7447\"]", "set ca, cert and key in [gateway.tls]"),
            ("listen = [\"quic/0.0.0.0:7447\"]", "needs [gateway.tls]"),
            ("listen = [\"quic/0.0.0.0:7447\"]\ntls = { ca = \"a\", cert = \"b\", key = \"c\" }", "has no access list"),
            ("connect = [\"quic/[fd00::1]:7447\"]", "expected a DNS name or an IPv4 address"),
            ("connect = [\"quic/fd00::1:7447\"]", "use a DNS name or an IPv4 address"),
            ("listen = [\"tls/0.0.0.0:7447\"]", "expected tcp/HOST:PORT or quic/HOST:PORT"),
            ("listen = [\"udp/127.0.0.1:7447\"]", "expected tcp/HOST:PORT or quic/HOST:PORT"),
            ("listen = [\"tcp/127.0.0.1\"]", "is not an endpoint"),
            ("listen = [\"tcp/127.0.0.1:7447#iface=eth0\"]", "is not an endpoint"),
            ("listen = \"tcp/127.0.0.1:7447\"", "expected an array of at most 16 strings"),
            ("tls = { ca = \"ca.pem\", cert = \"me.pem\" }", "\"key\" is missing"),
            ("rates = { health = 5 }", "gateway.rates.health: expected a string, found an integer"),
            ("rates = { health = \"some\" }", "expected \"all\" or \"off\""),
            ("rates = { attitude = 0 }", "expected 0.1 to 10000"),
            ("rates = { atitude = 5 }", "did you mean \"attitude\"?"),
            ("vehicle = \"Drone/7\"", "1 to 32"),
        ] {
            let problems = rejected(&format!("[gateway]\n{text}\n"));
            assert!(problems.contains(expected), "{text}: {problems}");
        }
    }
}

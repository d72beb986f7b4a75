//! One system on several hosts: checks of `export` and `import` of `[gateway]`, and the source of
//! the ticks on each host.

use graph::{Service, Topic};

use crate::{Launch, problem::Problem, toml_reader::Section};

/// Maximum number of ticks kept for disconnected hosts. This many ticks take about 100 MB.
pub const MAX_CACHE_TICKS: usize = 262_144;

/// Service that provides the ticks on a host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TickSource {
    /// Ingest numbers the samples of the source.
    Ingest,
    /// The gateway imports the ticks from another host.
    Gateway,
}

impl TickSource {
    /// Returns the service.
    pub const fn service(self) -> Service {
        match self {
            Self::Ingest => Service::Ingest,
            Self::Gateway => Service::Gateway,
        }
    }
}

impl Launch {
    /// Returns `true` if the service runs here and processes every tick. If an upstream service
    /// restarts, it must resend the ticks that such a service needs.
    pub fn consumes_ticks(&self, service: Service) -> bool {
        self.services.contains(&service)
            && (!service.is_auxiliary() || service.carries_ticks() && self.gateway.is_split())
    }

    /// Returns the service that provides the ticks on this host: the gateway if ticks are imported,
    /// else ingest.
    pub fn tick_source(&self) -> TickSource {
        if self.gateway.import.is_some() { TickSource::Gateway } else { TickSource::Ingest }
    }
}

/// Returns the problems with the services of one host in a split system.
pub(crate) fn validate(launch: &Launch, section: &Section<'_, '_>) -> Vec<Problem> {
    let Launch { services, gateway, ingest, .. } = launch;
    let span = || section.span("services").or_else(|| section.span("gateway")).unwrap_or_default();
    let mut list = Vec::new();
    let mut report = |title: String, label: &str| list.push(Problem::new(span(), title, label));
    let is_local = |service: Service| services.contains(&service);
    if !is_local(Service::Gateway) {
        report("services: \"gateway\" is missing, which carries topics between hosts".into(), "incomplete");
    }
    if !gateway.export.is_empty() && gateway.import.is_some() {
        report("gateway: topics are both exported and imported".into(), "a host can do only one of the two");
    }
    if ingest.source.is_blocking() {
        let title = "gateway: a replay or standard input cannot be split over hosts, because it waits for its slowest subscriber";
        report(title.into(), "only \"sim\", \"bus\", \"udp\" and \"serial\" can be split");
    }
    for topic in gateway.export.iter().filter(|topic| !publisher(topic).is_some_and(is_local)) {
        report(format!("gateway.export: no service here publishes {topic:?}"), "publishing service missing");
    }
    for topic in gateway.import.iter().flat_map(|import| &import.topics) {
        if publisher(topic).is_some_and(is_local) {
            report(format!("gateway.import: {topic:?} is also published here"), "import it or publish it here");
        }
    }
    for service in services {
        for topic in service.inputs().filter(|topic| !gateway.imports(*topic)) {
            let publisher = topic.entry().publishing_service();
            let topic = topic.name();
            if let Some(publisher) = publisher.filter(|publisher| !is_local(*publisher)) {
                let label = format!("list \"{publisher}\", or import {topic:?} in [gateway.import]");
                report(
                    format!(
                        "services: \"{service}\" needs the topic {topic:?}, which is neither published here nor imported"
                    ),
                    &label,
                );
            }
        }
    }
    let cache_ticks = gateway.cache_s * ingest.nominal_rate_hz();
    if cache_ticks > MAX_CACHE_TICKS as f64 {
        let title = format!("gateway.cache_s = {} is {cache_ticks:.0} ticks", gateway.cache_s);
        report(title, &format!("at most {MAX_CACHE_TICKS} ticks"));
    }
    list
}

/// Returns the service that publishes a topic.
fn publisher(topic: &str) -> Option<Service> {
    Topic::from_name(topic)?.entry().publishing_service()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOARD: &str = r#"
        services = ["ingest", "gyro", "accel", "gateway"]
        gateway = { export = ["gyro", "accel", "mag", "gnss"], cache_s = 10 }
    "#;
    const BASE: &str = r#"
        services = ["fuser", "course", "gateway"]
        gateway.import = { vehicle = "board", topics = ["gyro", "accel", "mag", "gnss"] }
    "#;

    #[test]
    fn both_halves_of_a_split_system_are_valid() {
        let board = Launch::parse("board.toml", BOARD).unwrap();
        assert_eq!(
            (&board.gateway.export[..], board.gateway.cache_s),
            (&["mag", "gnss", "gyro", "accel"].map(String::from)[..], 10.0)
        );
        assert!(board.consumes_ticks(Service::Gateway) && board.tick_source() == TickSource::Ingest);
        let base = Launch::parse("base.toml", BASE).unwrap();
        assert_eq!(base.gateway.import.as_ref().map(|import| import.topics.len()), Some(4));
        assert_eq!(base.tick_source(), TickSource::Gateway);
        assert!(!base.consumes_ticks(Service::Gyro) && !Launch::default().consumes_ticks(Service::Gateway));
    }

    #[test]
    fn impossible_split_is_rejected_with_remedy() {
        for (text, from, to, expected) in [
            (BASE, "\"gyro\", ", "", "\"fuser\" needs the topic \"gyro\", which is neither"),
            (BASE, "\"gnss\"", "\"mag\"", "list \"ingest\", or import \"gnss\" in [gateway.import]"),
            (BASE, ", \"gateway\"", "", "\"gateway\" is missing, which carries topics"),
            (BASE, "[\"fuser\"", "[\"gyro\", \"fuser\"", "\"gyro\" is also published here"),
            (BASE, "vehicle = \"board\", ", "", "gateway.import: \"vehicle\" is missing"),
            (
                BASE,
                "gateway.import",
                "ingest.source = \"replay\"\ningest.replay.file = \"a\"\ngateway.import",
                "a replay or standard input cannot be split",
            ),
            (BOARD, "\"accel\", \"gateway\"", "\"gateway\"", "no service here publishes \"accel\""),
            (
                BOARD,
                "\"gyro\", \"accel\", \"mag\"",
                "\"mag\"",
                "one of \"imu\", \"gyro\", \"accel\", \"fused\" must be",
            ),
            (BOARD, "\"mag\", \"gnss\"]", "\"mga\"]", "did you mean \"mag\"?"),
            (BOARD, "cache_s = 10", "cache_s = 600", "600000 ticks"),
            (BOARD, "cache_s = 10", "import = { vehicle = \"a\", topics = [\"fused\"] }", "both exported and imported"),
        ] {
            let changed = text.replacen(from, to, 1);
            assert_ne!(changed, text);
            let problems = Launch::parse("launch.toml", &changed).unwrap_err().to_string();
            assert!(problems.contains(expected), "{expected}: {problems}");
        }
    }
}

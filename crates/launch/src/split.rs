//! One system on several hosts: `export` and `import` of `[gateway]`, and which services a host then needs.

use graph::{Presence, Service, Topic};

use crate::{
    Launch,
    gateway::{Gateway, Import},
    model::system_name,
    problem::{Problem, quoted},
    walk::Section,
};

/// Ticks that are kept for hosts that were cut off, at most: some 100 MB.
pub const CACHE_TICKS_MAX: usize = 262_144;

impl Launch {
    /// The service runs here and takes each tick: those before it say again what it still needs when they are started again.
    pub fn follows(&self, service: Service) -> bool {
        self.services.contains(&service) && (!service.is_beside() || service.carries_ticks() && self.gateway.is_split())
    }

    /// The service that ticks come from: the gateway where they are imported.
    pub fn origin(&self) -> Service {
        if self.gateway.import.is_some() { Service::Gateway } else { Service::Ingest }
    }
}

/// Reads `export`, `cache_s` and `import`.
pub(crate) fn split(section: &mut Section<'_, '_>, out: &mut Gateway) {
    topics(section, "export", &mut out.export);
    section.number("cache_s", 1.0..=600.0, &mut out.cache_s);
    section.section("import", |section| {
        let mut import = Import::default();
        let expected = r#"1 to 32 of a-z, 0-9, "_" and "-""#;
        let named = section.text("vehicle", expected, system_name, &mut import.vehicle);
        let listed = topics(section, "topics", &mut import.topics);
        match ["vehicle", "topics"].into_iter().find(|key| !section.has(key)) {
            Some(key) => section.report_table(&format!("gateway.import: {key:?} is missing"), "from whom, and what"),
            None if named && listed => out.import = Some(import),
            None => {}
        }
    });
}

fn topics(section: &mut Section<'_, '_>, key: &'static str, out: &mut Vec<String>) -> bool {
    let allowed: Vec<_> = Topic::carried().map(|topic| (topic.name(), topic)).collect();
    let Some(listed) = section.choices(key, &allowed) else { return true };
    let all_known = listed.iter().all(Option::is_some);
    let listed: Vec<_> = listed.into_iter().flatten().map(|topic| *topic.get_ref()).collect();
    if all_known
        && !listed.iter().any(|topic| has_every_tick(*topic))
        && let Some(span) = section.span(key)
    {
        let [dense, sparse] = [true, false].map(|dense| {
            Topic::carried().filter(|topic| has_every_tick(*topic) == dense).map(Topic::name).collect::<Vec<_>>()
        });
        let note = Some(format!("{} are found by the flags of the ticks that they go with", sparse.join(" and ")));
        let title = format!("{key}: one of {} must be among the topics", quoted(&dense));
        section.report(Problem { note, ..Problem::new(span, title, "no topic with every tick") });
        return false;
    }
    // In one order, each once.
    *out = Topic::carried().filter(|topic| listed.contains(topic)).map(|topic| topic.name().into()).collect();
    all_known
}

/// What is wrong with the services of a host in a split system.
pub(crate) fn problems(launch: &Launch, section: &Section<'_, '_>) -> Vec<Problem> {
    let Launch { services, gateway, ingest, .. } = launch;
    let span = || section.span("services").or_else(|| section.span("gateway")).unwrap_or_default();
    let mut list = Vec::new();
    let mut report = |title: String, label: &str| list.push(Problem::new(span(), title, label));
    let runs_here = |service: Service| services.contains(&service);
    if !runs_here(Service::Gateway) {
        report("services: topics are carried by \"gateway\", which is missing".into(), "incomplete");
    }
    if !gateway.export.is_empty() && gateway.import.is_some() {
        report("gateway: topics are both exported and imported".into(), "a host does one of the two");
    }
    if ingest.source.waits() {
        let title = "gateway: a replay or standard input waits for its slowest reader and cannot be split over hosts";
        report(title.into(), "only \"sim\", \"bus\", \"udp\" and \"serial\" can be");
    }
    for topic in gateway.export.iter().filter(|topic| !maker(topic).is_some_and(runs_here)) {
        report(format!("gateway.export: nobody here publishes {topic:?}"), "its service is missing");
    }
    for topic in gateway.import.iter().flat_map(|import| &import.topics) {
        if maker(topic).is_some_and(runs_here) {
            report(format!("gateway.import: {topic:?} is published here as well"), "from here or from there");
        }
    }
    for service in services {
        for topic in service.inputs().filter(|topic| !gateway.imports(*topic)) {
            let maker = topic.entry().publishing_service();
            let topic = topic.name();
            if let Some(maker) = maker.filter(|maker| !runs_here(*maker)) {
                let label = format!("list \"{maker}\", or import {topic:?} in [gateway.import]");
                report(format!("services: \"{service}\" needs the topic {topic:?}, which nobody brings"), &label);
            }
        }
    }
    let cache_ticks = gateway.cache_s * ingest.declared_rate_hz().unwrap_or(0.0);
    if cache_ticks > CACHE_TICKS_MAX as f64 {
        let title = format!("gateway.cache_s = {} is {cache_ticks:.0} ticks", gateway.cache_s);
        report(title, &format!("{CACHE_TICKS_MAX} at most"));
    }
    list
}

/// The service that publishes a topic.
fn maker(topic: &str) -> Option<Service> {
    Topic::named(topic)?.entry().publishing_service()
}

fn has_every_tick(topic: Topic) -> bool {
    topic.entry().presence == Presence::EveryTick
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
    fn both_halves_of_a_split_system_are_taken() {
        let board = Launch::parse("board.toml", BOARD).unwrap();
        assert_eq!(
            (&board.gateway.export[..], board.gateway.cache_s),
            (&["mag", "gnss", "gyro", "accel"].map(String::from)[..], 10.0)
        );
        assert!(board.follows(Service::Gateway) && board.origin() == Service::Ingest);
        let base = Launch::parse("base.toml", BASE).unwrap();
        assert_eq!(base.gateway.import.as_ref().map(|import| import.topics.len()), Some(4));
        assert_eq!(base.origin(), Service::Gateway);
        assert!(!base.follows(Service::Gyro) && !Launch::default().follows(Service::Gateway));
    }

    #[test]
    fn what_cannot_work_is_refused_with_the_remedy() {
        for (text, from, to, said) in [
            (BASE, "\"gyro\", ", "", "\"fuser\" needs the topic \"gyro\", which nobody brings"),
            (BASE, "\"gnss\"", "\"mag\"", "list \"ingest\", or import \"gnss\" in [gateway.import]"),
            (BASE, ", \"gateway\"", "", "topics are carried by \"gateway\", which is missing"),
            (BASE, "[\"fuser\"", "[\"gyro\", \"fuser\"", "\"gyro\" is published here as well"),
            (BASE, "vehicle = \"board\", ", "", "gateway.import: \"vehicle\" is missing"),
            (
                BASE,
                "gateway.import",
                "ingest.source = \"replay\"\ningest.replay.file = \"a\"\ngateway.import",
                "a replay or standard input waits",
            ),
            (BOARD, "\"accel\", \"gateway\"", "\"gateway\"", "nobody here publishes \"accel\""),
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
            assert!(problems.contains(said), "{said}: {problems}");
        }
    }
}

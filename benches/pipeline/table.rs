//! Results of all rounds, as a table or as JSON.

use std::fmt;

use serde::Serialize;

use crate::{Cost, Failure, LatencyUs, Mode, Phases, RATES_HZ, Variant, median::median};

/// Results of the runs in all rounds.
#[derive(Serialize)]
pub(crate) struct Table {
    rounds: usize,
    seconds: f64,
    runs: Vec<Run>,
}

#[derive(Serialize)]
struct Run {
    round: usize,
    #[serde(flatten)]
    condition: Condition,
    #[serde(flatten)]
    cost: Cost,
}

/// Conditions shared by the runs of a row.
#[derive(Clone, Copy, PartialEq, Serialize)]
struct Condition {
    mode: Mode,
    rate_hz: u32,
    variant: Variant,
}

/// Row of the table. Each value is the median over the rounds, except that `max` is the largest
/// value and `lost` is the sum.
#[derive(Serialize)]
struct Row {
    #[serde(flatten)]
    condition: Condition,
    #[serde(flatten)]
    cost: Cost,
    /// Ratio of the median latency to that of `raw` in the same round.
    ratio_p50: f64,
    /// Ratio of the CPU time to that of `raw` in the same round.
    ratio_cpu: f64,
    /// Ratios of `real` to `other` in the same round: median latency, CPU time, CPU time of the
    /// start-up phase, and CPU time per tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    to_other: Option<[f64; 4]>,
}

/// Returns the medians of the phases, or `None` if they were not measured.
fn phases(costs: &[Cost]) -> Option<Phases> {
    let measured: Vec<Phases> = costs.iter().filter_map(|cost| cost.phases).collect();
    (!measured.is_empty()).then(|| Phases {
        start_s: median(measured.iter().map(|phases| phases.start_s)),
        tick_us: median(measured.iter().map(|phases| phases.tick_us)),
    })
}

impl Table {
    pub(crate) fn new(rounds: usize, seconds: f64) -> Self {
        Self { rounds, seconds, runs: Vec::new() }
    }

    pub(crate) fn add(&mut self, round: usize, mode: Mode, rate_hz: u32, variant: Variant, cost: Cost) {
        self.runs.push(Run { round, condition: Condition { mode, rate_hz, variant }, cost });
    }

    /// Returns the rows and the runs as a JSON object on one line.
    pub(crate) fn json(&self) -> Result<String, Failure> {
        #[derive(Serialize)]
        struct Report<'a> {
            rows: Vec<Row>,
            #[serde(flatten)]
            table: &'a Table,
        }
        Ok(serde_json::to_string(&Report { rows: self.rows().collect(), table: self })?)
    }

    fn rows(&self) -> impl Iterator<Item = Row> {
        let conditions = [Mode::Free, Mode::One].into_iter().flat_map(|mode| {
            RATES_HZ.into_iter().flat_map(move |rate_hz| {
                let variants = [Variant::Raw, Variant::Bus, Variant::Real, Variant::Other];
                variants.map(|variant| Condition { mode, rate_hz, variant })
            })
        });
        conditions
            .filter(|condition| self.runs.iter().any(|run| run.condition == *condition))
            .map(|condition| self.row(condition))
    }

    fn row(&self, condition: Condition) -> Row {
        let [costs, raw, other] = [condition.variant, Variant::Raw, Variant::Other]
            .map(|variant| self.costs(Condition { variant, ..condition }));
        let over = |pick: fn(&Cost) -> f64| median(costs.iter().map(pick));
        let ratio = |to: &[Cost], pick: fn(&Cost) -> f64| {
            median(costs.iter().zip(to).map(|(cost, reference)| pick(cost) / pick(reference)))
        };
        let picks: [fn(&Cost) -> f64; 4] = [
            |cost| cost.latency_us.p50,
            |cost| cost.cpu_s_per_s,
            |cost| cost.phases.map_or(f64::NAN, |phases| phases.start_s),
            |cost| cost.phases.map_or(f64::NAN, |phases| phases.tick_us),
        ];
        let compares = condition.variant == Variant::Real && !other.is_empty();
        Row {
            condition,
            cost: Cost {
                latency_us: LatencyUs {
                    p50: over(|cost| cost.latency_us.p50),
                    p99: over(|cost| cost.latency_us.p99),
                    p999: over(|cost| cost.latency_us.p999),
                    max: costs.iter().map(|cost| cost.latency_us.max).fold(0.0, f64::max),
                },
                cpu_s_per_s: over(|cost| cost.cpu_s_per_s),
                lost: costs.iter().map(|cost| cost.lost).sum(),
                phases: phases(&costs),
            },
            ratio_p50: ratio(&raw, picks[0]),
            ratio_cpu: ratio(&raw, picks[1]),
            to_other: compares.then(|| picks.map(|pick| ratio(&other, pick))),
        }
    }

    /// Returns the results in the order of the rounds.
    fn costs(&self, condition: Condition) -> Vec<Cost> {
        self.runs.iter().filter(|run| run.condition == condition).map(|run| run.cost).collect()
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "medians over {} rounds of {} s; max: largest; lost: sum", self.rounds, self.seconds)?;
        writeln!(
            f,
            "{:5} {:>5}  {:7} {:>8} {:>8} {:>8} {:>8} {:>8} {:>6} {:>9} {:>9}  {:>7} {:>7}",
            "cores",
            "Hz",
            "variant",
            "p50 µs",
            "p99 µs",
            "p99.9 µs",
            "max µs",
            "CPU s/s",
            "lost",
            "p50/raw",
            "CPU/raw",
            "start s",
            "tick µs"
        )?;
        for Row { condition, cost, ratio_p50, ratio_cpu, to_other } in self.rows() {
            let LatencyUs { p50, p99, p999, max } = cost.latency_us;
            let cores = match condition.mode {
                Mode::Free => "free",
                Mode::One => "one",
            };
            let variant = match condition.variant {
                Variant::Raw => "raw",
                Variant::Bus => "bus",
                Variant::Real => "real",
                Variant::Other => "other",
            };
            write!(
                f,
                "{cores:5} {:>5}  {variant:7} {p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.0} {:>8.3} {:>6} {ratio_p50:>9.2} {ratio_cpu:>9.2}",
                condition.rate_hz, cost.cpu_s_per_s, cost.lost
            )?;
            if let Some(Phases { start_s, tick_us }) = cost.phases {
                write!(f, "  {start_s:>7.3} {tick_us:>7.1}")?;
            }
            match to_other {
                Some([p50, cpu, start, tick]) => {
                    writeln!(f, "  to other: p50 {p50:.2}, CPU {cpu:.2}, start {start:.2}, tick {tick:.2}")?;
                }
                None => writeln!(f)?,
            }
        }
        Ok(())
    }
}

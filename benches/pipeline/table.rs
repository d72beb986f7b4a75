//! What the rounds come to: for people a table, for scripts an object.

use std::fmt;

use serde::Serialize;

use crate::{Cost, Failure, LatencyUs, Mode, RATES_HZ, Variant, median::median};

/// All runs of all rounds.
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
    place: Place,
    #[serde(flatten)]
    cost: Cost,
}

/// What the runs of a row have in common.
#[derive(Clone, Copy, PartialEq, Serialize)]
struct Place {
    mode: Mode,
    rate_hz: u32,
    variant: Variant,
}

/// Medians over the rounds; of `max` the largest, of `lost` the sum.
#[derive(Serialize)]
struct Row {
    #[serde(flatten)]
    place: Place,
    #[serde(flatten)]
    cost: Cost,
    /// To `raw` in the same round.
    ratio_p50: f64,
    ratio_cpu: f64,
}

impl Table {
    pub(crate) fn new(rounds: usize, seconds: f64) -> Self {
        Self { rounds, seconds, runs: Vec::new() }
    }

    pub(crate) fn add(&mut self, round: usize, mode: Mode, rate_hz: u32, variant: Variant, cost: Cost) {
        self.runs.push(Run { round, place: Place { mode, rate_hz, variant }, cost });
    }

    /// The rows and the runs as one object on one line.
    pub(crate) fn json(&self) -> Result<String, Failure> {
        #[derive(Serialize)]
        struct Whole<'a> {
            rows: Vec<Row>,
            #[serde(flatten)]
            table: &'a Table,
        }
        Ok(serde_json::to_string(&Whole { rows: self.rows().collect(), table: self })?)
    }

    fn rows(&self) -> impl Iterator<Item = Row> {
        let places = [Mode::Free, Mode::One].into_iter().flat_map(|mode| {
            RATES_HZ.into_iter().flat_map(move |rate_hz| {
                [Variant::Raw, Variant::Bus, Variant::Real].map(|variant| Place { mode, rate_hz, variant })
            })
        });
        places.map(|place| self.row(place))
    }

    fn row(&self, place: Place) -> Row {
        let (costs, limits) = (self.costs(place), self.costs(Place { variant: Variant::Raw, ..place }));
        let over = |pick: fn(&Cost) -> f64| median(costs.iter().map(pick));
        let ratio =
            |pick: fn(&Cost) -> f64| median(costs.iter().zip(&limits).map(|(cost, raw)| pick(cost) / pick(raw)));
        Row {
            place,
            cost: Cost {
                latency_us: LatencyUs {
                    p50: over(|cost| cost.latency_us.p50),
                    p99: over(|cost| cost.latency_us.p99),
                    p999: over(|cost| cost.latency_us.p999),
                    max: costs.iter().map(|cost| cost.latency_us.max).fold(0.0, f64::max),
                },
                cpu_s_per_s: over(|cost| cost.cpu_s_per_s),
                lost: costs.iter().map(|cost| cost.lost).sum(),
            },
            ratio_p50: ratio(|cost| cost.latency_us.p50),
            ratio_cpu: ratio(|cost| cost.cpu_s_per_s),
        }
    }

    /// Round by round.
    fn costs(&self, place: Place) -> Vec<Cost> {
        self.runs.iter().filter(|run| run.place == place).map(|run| run.cost).collect()
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "medians over {} rounds of {} s; max: the largest; lost: the sum", self.rounds, self.seconds)?;
        writeln!(
            f,
            "{:5} {:>5}  {:7} {:>8} {:>8} {:>8} {:>8} {:>8} {:>6} {:>9} {:>9}",
            "cores", "Hz", "variant", "p50 µs", "p99 µs", "p99.9 µs", "max µs", "CPU s/s", "lost", "p50/raw", "CPU/raw"
        )?;
        for Row { place, cost, ratio_p50, ratio_cpu } in self.rows() {
            let LatencyUs { p50, p99, p999, max } = cost.latency_us;
            let cores = match place.mode {
                Mode::Free => "free",
                Mode::One => "one",
            };
            let variant = match place.variant {
                Variant::Raw => "raw",
                Variant::Bus => "bus",
                Variant::Real => "real",
            };
            writeln!(
                f,
                "{cores:5} {:>5}  {variant:7} {p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.0} {:>8.3} {:>6} {ratio_p50:>9.2} {ratio_cpu:>9.2}",
                place.rate_hz, cost.cpu_s_per_s, cost.lost
            )?;
        }
        Ok(())
    }
}

//! S4: orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter.

mod drawings;
mod runs;

use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, ORANGE, PURPLE, SKY, LineStyle},
};
use plotters::style::RGBColor;

use crate::{
    Progress,
    picture::{Figure, Panel, Part, Picture},
    table::Table,
};
use runs::{DURATION_S, StageErrors, ErrorSample, SEEDS, STAGES, run_flights};
pub use runs::{GnssCoverage, SquaredErrors};

/// Every flight with every seed.
pub(crate) const RUN_COUNT: u64 = GnssCoverage::ALL.len() as u64 * SEEDS;

/// Of the stages, in their order; what others lie on is wider.
const STYLES: [(RGBColor, LineStyle); 4] =
    [(SKY, LineStyle::Wide), (PURPLE, LineStyle::Thick), (ORANGE, LineStyle::Thin), (BLUE, LineStyle::Thin)];

/// What the page says of the data.
const DATA_NOTE: &str = "The paper's flight is not published; the simulated cruise stands for it, with the same length: turns of 2 to 3 °/s for 20 to 60 s, gyro ±0.05 °/s and 0.05 °/s rms, accelerometer ±0.02 m/s² and 0.02 m/s² rms, velocity 0.05 m/s rms, 0.2 s late.";

/// Figures 1 to 7, the course and the table.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let [always, gaps, never] = GnssCoverage::ALL.map(|coverage| run_flights(coverage, || progress.step()));
    vec![
        drawings::axes(),
        drawings::aided(),
        errors(
            "figure-4",
            "Figure 4: signed errors with a receiver all the time",
            2.0,
            &always,
            "The paper's pitch, against a fibre-optic system in a helicopter's cruise of about 3,500 s: roll and pitch RMS 0.2° to 0.5°. levelling and levelling-unified are one law here.",
        ),
        drawings::autonomous(),
        errors(
            "figure-6",
            "Figure 6: signed errors without one fix",
            10.0,
            &never,
            "The paper: 0.3° to 1.0° RMS. With a gyro bias of 0.05 °/s that nobody takes out, a loop of 60 s carries 3° of tilt: the paper's figure needs a better gyro, or what it leaves unsaid. levelling, levelling-unified and levelling-pi are one law here, and their curves lie on each other.",
        ),
        drawings::unified(),
        errors(
            "figure-7-errors",
            "Figure 7: signed errors with a gap of 60 s every 240 s",
            10.0,
            &gaps,
            "As printed the second platform answers in every gap: it has carried the bias all the time, and at each edge roll and pitch jump by as much as the platforms are apart. One attitude with both laws (levelling) leaves the aided level only slowly; with the bias known (levelling-pi, aided) a gap costs nearly nothing.",
        ),
        course(&always, &gaps),
        table(&always, &gaps, &never),
        course_table(&always, &gaps),
    ]
}

fn time_axis() -> Axis {
    Axis::new("time, s", 0.0..DURATION_S)
}

/// A curve is broken where an angle wraps.
fn line(name: &str, color: RGBColor, style: LineStyle, of: &[ErrorSample], value: fn(&ErrorSample) -> f64) -> Curve {
    let values: Vec<_> = of.iter().map(|sample| (sample.t_s, value(sample))).collect();
    Curve::over_time(name, color, style, &values, 180.0)
}

fn errors(name: &'static str, title: &str, range_deg: f64, flights: &[StageErrors], caption: &str) -> Part {
    let panel = |title: &str, label, value: fn(&ErrorSample) -> f64| {
        // What is nearest to the truth lies on top.
        let curves = STAGES
            .iter()
            .zip(STYLES)
            .zip(flights)
            .map(|((name, (color, style)), flights)| line(name, color, style, &flights.samples, value));
        Panel::Chart(Chart {
            title: title.into(),
            x: time_axis(),
            y: Axis::new(label, -range_deg..range_deg),
            curves: curves.collect(),
            has_legend: true,
        })
    };
    let panels = vec![
        panel("pitch", "pitch error, °", |sample| sample.pitch_deg),
        panel("roll", "roll error, °", |sample| sample.roll_deg),
    ];
    let rms: Vec<_> = STAGES
        .iter()
        .zip(flights)
        .map(|(name, flights)| {
            format!("{name} {} / {}", format_deg(flights.total().roll_deg()), format_deg(flights.total().pitch_deg()))
        })
        .collect();
    Part {
        name,
        title: title.into(),
        caption: format!(
            "{DATA_NOTE} {caption} Ours, roll / pitch RMS of the whole flight from 120 s on, {SEEDS} seeds: {}.",
            rms.join(", ")
        ),
        picture: Picture::Figure(Figure { size: (1100, 800), columns: 1, panels }),
    }
}

fn course(always: &[StageErrors], gaps: &[StageErrors]) -> Part {
    let panel = |title: &str, flights: &[StageErrors]| {
        let of = |stage: usize| flights.get(stage).map_or(&[][..], |flights| &flights.samples);
        let curves = vec![
            line("levelling, track", SKY, LineStyle::Wide, of(0), |sample| sample.course_deg),
            line("levelling-unified", PURPLE, LineStyle::Thick, of(1), |sample| sample.heading_deg),
            line("levelling-pi, track", ORANGE, LineStyle::Thin, of(2), |sample| sample.course_deg),
            line("aided", BLUE, LineStyle::Thin, of(3), |sample| sample.heading_deg),
        ];
        Panel::Chart(Chart {
            title: title.into(),
            x: time_axis(),
            y: Axis::new("course error, °", -15.0..15.0),
            curves,
            has_legend: true,
        })
    };
    let free = always.first().map_or(&[][..], |flights| &flights.samples);
    // The gyroscopic course is counted from where it began.
    let from = free.first().map_or(0.0, |sample| sample.heading_deg);
    let gyroscopic: Vec<_> = free
        .iter()
        .map(|m| (m.t_s, attitude::state::wrapped_rad((m.heading_deg - from).to_radians()).to_degrees()))
        .collect();
    let alone = Panel::Chart(Chart {
        title: "the gyroscopic course alone".into(),
        x: time_axis(),
        y: Axis::new("course error, °", -180.0..180.0),
        curves: vec![Curve::over_time("levelling", GREEN, LineStyle::Thick, &gyroscopic, 180.0)],
        has_legend: true,
    });
    let panels = vec![
        panel("the complex course (5), T = 50 s, with a receiver all the time", always),
        panel("with a gap of 60 s every 240 s", gaps),
        alone,
    ];
    Part {
        name: "course",
        title: "The complex course with the track (5)".into(),
        caption: "H_k = H_{k−1} + ΔHΓ − h (H_{k−1} − H_track)/T: a bias b about the vertical leaves T b = 2.5° of 0.05 °/s, and in a gap of 60 s 3° more. The stage track of the slot course behind levelling and levelling-pi; levelling-unified has it within; aided finds true north by itself. The gyroscopic course alone drifts by 175° in this time.".into(),
        picture: Picture::Figure(Figure { size: (1100, 1100), columns: 1, panels }),
    }
}

fn format_deg(deg: Option<f64>) -> String {
    deg.map_or("–".into(), |deg| format!("{deg:.3}"))
}

fn table(always: &[StageErrors], gaps: &[StageErrors], never: &[StageErrors]) -> Part {
    let paper = |name: &str, aided: &str, alone: &str| {
        let cells = [name, aided, aided, "–", "–", "–", "–", alone, alone];
        cells.iter().map(|cell| (*cell).into()).collect::<Vec<String>>()
    };
    let mut rows = vec![paper("the paper, in flight", "0.2–0.5", "0.3–1.0")];
    for (stage, name) in STAGES.iter().enumerate() {
        let of = |flights: &[StageErrors], pick: fn(&StageErrors) -> SquaredErrors| {
            let sums = flights.get(stage).map(pick).unwrap_or_default();
            [format_deg(sums.roll_deg()), format_deg(sums.pitch_deg())]
        };
        let cells = [
            of(always, |flights| flights.aided),
            of(gaps, |flights| flights.aided),
            of(gaps, |flights| flights.autonomous),
            of(never, |flights| flights.autonomous),
        ];
        rows.push([(*name).into()].into_iter().chain(cells.into_iter().flatten()).collect());
    }
    Part {
        name: "table-errors",
        title: "Table: RMS by axis, format_deg".into(),
        caption: format!("{DATA_NOTE} {SEEDS} seeds, from 120 s on."),
        picture: Picture::Table(Table::new(
            &[
                "stage",
                "aided: roll",
                "pitch",
                "gaps, aided: roll",
                "pitch",
                "in the gaps: roll",
                "pitch",
                "never a fix: roll",
                "pitch",
            ],
            rows,
        )),
    }
}

fn course_table(always: &[StageErrors], gaps: &[StageErrors]) -> Part {
    let row = |(stage, name): (usize, &&str)| {
        let of = |flights: &[StageErrors]| {
            let sums = flights.get(stage).map(StageErrors::total).unwrap_or_default();
            // A heading that is counted from anywhere is no course.
            let own = if stage == 0 { None } else { sums.heading_deg() };
            [format_deg(own), format_deg(sums.course_deg())]
        };
        [(*name).to_string()].into_iter().chain(of(always)).chain(of(gaps)).collect()
    };
    Part {
        name: "table-course",
        title: "Table: course RMS, format_deg".into(),
        caption: "The stage's own heading, and the course of the stage track behind it; behind a heading that is true already track corrects what is left.".into(),
        picture: Picture::Table(Table::new(
            &["stage", "aided: own", "with track", "gaps: own", "with track"],
            STAGES.iter().enumerate().map(row).collect(),
        )),
    }
}

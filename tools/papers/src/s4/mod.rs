//! S4: orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter.

mod drawings;
mod runs;

use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, ORANGE, PURPLE, SKY, Style},
};
use plotters::style::RGBColor;

use crate::{
    Progress,
    picture::{Figure, Panel, Part, Picture},
    table::Table,
};
use runs::{DURATION_S, Flown, Moment, SEEDS, STAGES, fly_all};
pub use runs::{Receiver, Sums};

/// Every flight with every seed.
pub(crate) const RUNS: u64 = Receiver::ALL.len() as u64 * SEEDS;

/// Of the stages, in their order; what others lie on is wider.
const LOOKS: [(RGBColor, Style); 4] =
    [(SKY, Style::Wide), (PURPLE, Style::Thick), (ORANGE, Style::Thin), (BLUE, Style::Thin)];

/// What the page says of the data.
const FLIGHT: &str = "The paper's flight is not published; the simulated cruise stands for it, with the same length: turns of 2 to 3 °/s for 20 to 60 s, gyro ±0.05 °/s and 0.05 °/s rms, accelerometer ±0.02 m/s² and 0.02 m/s² rms, velocity 0.05 m/s rms, 0.2 s late.";

/// Figures 1 to 7, the course and the table.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let [always, gaps, never] = Receiver::ALL.map(|receiver| fly_all(receiver, || progress.step()));
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

fn time() -> Axis {
    Axis::new("time, s", 0.0..DURATION_S)
}

/// A curve is broken where an angle wraps.
fn line(name: &str, color: RGBColor, style: Style, of: &[Moment], value: fn(&Moment) -> f64) -> Curve {
    let values: Vec<_> = of.iter().map(|moment| (moment.t_s, value(moment))).collect();
    Curve::over_time(name, color, style, &values, 180.0)
}

fn errors(name: &'static str, title: &str, most_deg: f64, flown: &[Flown], about: &str) -> Part {
    let panel = |title: &str, label, value: fn(&Moment) -> f64| {
        // What is nearest to the truth lies on top.
        let curves = STAGES
            .iter()
            .zip(LOOKS)
            .zip(flown)
            .map(|((name, (color, style)), flown)| line(name, color, style, &flown.moments, value));
        Panel::Chart(Chart {
            title: title.into(),
            x: time(),
            y: Axis::new(label, -most_deg..most_deg),
            curves: curves.collect(),
            named: true,
        })
    };
    let panels = vec![
        panel("pitch", "pitch error, °", |moment| moment.pitch_deg),
        panel("roll", "roll error, °", |moment| moment.roll_deg),
    ];
    let rms: Vec<_> = STAGES
        .iter()
        .zip(flown)
        .map(|(name, flown)| {
            format!("{name} {} / {}", degrees(flown.whole().roll_deg()), degrees(flown.whole().pitch_deg()))
        })
        .collect();
    Part {
        name,
        title: title.into(),
        about: format!(
            "{FLIGHT} {about} Ours, roll / pitch RMS of the whole flight from 120 s on, {SEEDS} seeds: {}.",
            rms.join(", ")
        ),
        picture: Picture::Figure(Figure { size: (1100, 800), columns: 1, panels }),
    }
}

fn course(always: &[Flown], gaps: &[Flown]) -> Part {
    let panel = |title: &str, flown: &[Flown]| {
        let of = |stage: usize| flown.get(stage).map_or(&[][..], |flown| &flown.moments);
        let curves = vec![
            line("levelling, track", SKY, Style::Wide, of(0), |moment| moment.course_deg),
            line("levelling-unified", PURPLE, Style::Thick, of(1), |moment| moment.heading_deg),
            line("levelling-pi, track", ORANGE, Style::Thin, of(2), |moment| moment.course_deg),
            line("aided", BLUE, Style::Thin, of(3), |moment| moment.heading_deg),
        ];
        Panel::Chart(Chart {
            title: title.into(),
            x: time(),
            y: Axis::new("course error, °", -15.0..15.0),
            curves,
            named: true,
        })
    };
    let free = always.first().map_or(&[][..], |flown| &flown.moments);
    // The gyroscopic course is counted from where it began.
    let from = free.first().map_or(0.0, |moment| moment.heading_deg);
    let gyroscopic: Vec<_> = free
        .iter()
        .map(|m| (m.t_s, attitude::state::wrapped_rad((m.heading_deg - from).to_radians()).to_degrees()))
        .collect();
    let alone = Panel::Chart(Chart {
        title: "the gyroscopic course alone".into(),
        x: time(),
        y: Axis::new("course error, °", -180.0..180.0),
        curves: vec![Curve::over_time("levelling", GREEN, Style::Thick, &gyroscopic, 180.0)],
        named: true,
    });
    let panels = vec![
        panel("the complex course (5), T = 50 s, with a receiver all the time", always),
        panel("with a gap of 60 s every 240 s", gaps),
        alone,
    ];
    Part {
        name: "course",
        title: "The complex course with the track (5)".into(),
        about: "H_k = H_{k−1} + ΔHΓ − h (H_{k−1} − H_track)/T: a bias b about the vertical leaves T b = 2.5° of 0.05 °/s, and in a gap of 60 s 3° more. The stage track of the slot course behind levelling and levelling-pi; levelling-unified has it within; aided finds true north by itself. The gyroscopic course alone drifts by 175° in this time.".into(),
        picture: Picture::Figure(Figure { size: (1100, 1100), columns: 1, panels }),
    }
}

fn degrees(deg: Option<f64>) -> String {
    deg.map_or("–".into(), |deg| format!("{deg:.3}"))
}

fn table(always: &[Flown], gaps: &[Flown], never: &[Flown]) -> Part {
    let paper = |name: &str, aided: &str, alone: &str| {
        let cells = [name, aided, aided, "–", "–", "–", "–", alone, alone];
        cells.iter().map(|cell| (*cell).into()).collect::<Vec<String>>()
    };
    let mut rows = vec![paper("the paper, in flight", "0.2–0.5", "0.3–1.0")];
    for (stage, name) in STAGES.iter().enumerate() {
        let of = |flown: &[Flown], pick: fn(&Flown) -> Sums| {
            let sums = flown.get(stage).map(pick).unwrap_or_default();
            [degrees(sums.roll_deg()), degrees(sums.pitch_deg())]
        };
        let cells = [
            of(always, |flown| flown.aided),
            of(gaps, |flown| flown.aided),
            of(gaps, |flown| flown.alone),
            of(never, |flown| flown.alone),
        ];
        rows.push([(*name).into()].into_iter().chain(cells.into_iter().flatten()).collect());
    }
    Part {
        name: "table-errors",
        title: "Table: RMS by axis, degrees".into(),
        about: format!("{FLIGHT} {SEEDS} seeds, from 120 s on."),
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

fn course_table(always: &[Flown], gaps: &[Flown]) -> Part {
    let row = |(stage, name): (usize, &&str)| {
        let of = |flown: &[Flown]| {
            let sums = flown.get(stage).map(Flown::whole).unwrap_or_default();
            // A heading that is counted from anywhere is no course.
            let own = if stage == 0 { None } else { sums.heading_deg() };
            [degrees(own), degrees(sums.course_deg())]
        };
        [(*name).to_string()].into_iter().chain(of(always)).chain(of(gaps)).collect()
    };
    Part {
        name: "table-course",
        title: "Table: course RMS, degrees".into(),
        about: "The stage's own heading, and the course of the stage track behind it; behind a heading that is true already track corrects what is left.".into(),
        picture: Picture::Table(Table::new(
            &["stage", "aided: own", "with track", "gaps: own", "with track"],
            STAGES.iter().enumerate().map(row).collect(),
        )),
    }
}

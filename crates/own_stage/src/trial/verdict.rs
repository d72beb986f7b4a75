//! What is wrong with what came out.

use messages::{Flags, Ticked};
use runtime::shadow::Comparable;

use super::{
    INCARNATION,
    path::{Place, Tick},
};

/// Each tick once, in order, with its own time, its flags and the owner's stamp.
pub(super) fn order<P: Place>(given: &[Tick], outputs: &[P::Output]) -> Option<String> {
    let wrong = given.iter().zip(outputs).find_map(|(tick, output)| {
        let (due, header) = (tick.imu.header, output.header());
        let times = |header: &messages::Header| (header.t_start_ns, header.t_end_ns, header.t_born_ns);
        let lost = Flags(due.flags.0 & !header.flags.0);
        Some(match () {
            () if header.tick != due.tick => format!("tick {} where {} is due", header.tick, due.tick),
            () if times(header) != times(&due) => format!("tick {} with other times than it came with", due.tick),
            () if header.t_sent_ns < header.t_born_ns => format!("tick {} sent before it was born", due.tick),
            () if (header.epoch, header.incarnation) != (1, INCARNATION) => {
                format!("tick {} under decision {} of life {}", due.tick, header.epoch, header.incarnation)
            }
            () if lost != Flags::NONE => format!("tick {} without its flags {lost}", due.tick),
            () => return None,
        })
    });
    wrong.or_else(|| (given.len() != outputs.len()).then(|| format!("{} ticks of {}", outputs.len(), given.len())))
}

/// The first output that is not finite, or no rotation, or tells a standard deviation below zero.
pub(super) fn unsound<O: Ticked + Comparable>(outputs: &[O]) -> Option<String> {
    let layout = O::layout();
    outputs.iter().find_map(|output| {
        let tick = output.header().tick;
        let bytes = bytemuck::bytes_of(output);
        for field in layout.fields.iter().filter(|field| field.kind.contains("f64")) {
            let end = layout.fields.iter().map(|next| next.offset).filter(|next| *next > field.offset).min();
            let numbers = bytes.get(field.offset..end.unwrap_or(layout.size)).unwrap_or_default();
            for number in numbers.as_chunks().0.iter().map(|chunk| f64::from_le_bytes(*chunk)) {
                if !number.is_finite() || field.name.ends_with("_sd_rad") && number < 0.0 {
                    return Some(format!("tick {tick}: {} is {number}", field.name));
                }
            }
        }
        let norm = output.attitude().map(|quaternion| quaternion.norm());
        let rotation = norm.is_some_and(|norm| (norm - 1.0).abs() < 1e-9);
        (!rotation).then(|| format!("tick {tick}: no rotation"))
    })
}

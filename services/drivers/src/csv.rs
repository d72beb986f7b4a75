//! Our own lines, as in a recording: with a header before them, or, of 7 or 10 numbers, without.

use decoders::{Counts, Decoder, DeviceTime, Measurement, Value};
use recording::{Row, Rows};

/// As in a recording.
const LINE_BYTES_MAX: usize = 1 << 16;
/// The columns of lines that have no header, by how many they are.
const HEADERS: [&str; 2] = ["t_s,gx,gy,gz,ax,ay,az", "t_s,gx,gy,gz,ax,ay,az,mx,my,mz"];

/// Takes lines apart.
#[derive(Default)]
pub(crate) struct Csv {
    /// What the header said.
    rows: Option<Rows>,
    /// The line that has not ended.
    line: Vec<u8>,
    /// It is longer than a line can be, and is left out to its end.
    is_endless: bool,
    counts: Counts,
}

impl Decoder for Csv {
    fn push(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) {
        let mut pieces = bytes.split(|byte| *byte == b'\n').peekable();
        while let Some(piece) = pieces.next() {
            if self.line.len() + piece.len() > LINE_BYTES_MAX {
                self.counts.skipped_bytes += (self.line.len() + piece.len()) as u64;
                self.line.clear();
                self.is_endless = true;
            } else if self.is_endless {
                self.counts.skipped_bytes += piece.len() as u64;
            } else {
                self.line.extend_from_slice(piece);
            }
            if pieces.peek().is_some() {
                let line = std::mem::take(&mut self.line);
                if std::mem::take(&mut self.is_endless) {
                    self.counts.refused += 1;
                } else {
                    self.end_line(&line, found);
                }
                self.line = line;
                self.line.clear();
            }
        }
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

impl Csv {
    fn end_line(&mut self, line: &[u8], found: &mut Vec<Measurement>) {
        if line.trim_ascii().is_empty() {
            return;
        }
        self.counts.frames += 1;
        if let Some(row) = self.rows.as_mut().and_then(|rows| rows.row(line).ok()) {
            return found.push(measured(&row));
        }
        // Another program may have begun, with columns of its own.
        if let Ok(rows) = Rows::of_header(line) {
            self.rows = Some(rows);
            return;
        }
        if self.rows.is_none()
            && let Some((rows, row)) = HEADERS.iter().find_map(|header| {
                let mut rows = Rows::of_header(header.as_bytes()).ok()?;
                let row = rows.row(line).ok()?;
                Some((rows, row))
            })
        {
            self.rows = Some(rows);
            return found.push(measured(&row));
        }
        self.counts.frames -= 1;
        self.counts.refused += 1;
    }
}

fn measured(row: &Row) -> Measurement {
    let Row { t_ns, rate_rad_s, force_m_s2, field_ut, .. } = *row;
    Measurement {
        // A time before the zero of a recording comes out as it went in.
        time: Some(DeviceTime::SinceBoot { now_ns: t_ns.cast_unsigned() }),
        value: Value::Imu { rate_rad_s, force_m_s2, field_ut },
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    /// The times of what is found in the text, given in pieces of each length, and what was refused.
    fn times(text: &str) -> (Vec<i64>, u64) {
        let of_pieces = |length: usize| {
            let (mut csv, mut found) = (Csv::default(), Vec::new());
            text.as_bytes().chunks(length).for_each(|piece| csv.push(piece, &mut found));
            let time = |measurement: &Measurement| match measurement.time {
                Some(DeviceTime::SinceBoot { now_ns }) => now_ns.cast_signed(),
                _ => panic!("{measurement:?}"),
            };
            (found.iter().map(time).collect::<Vec<_>>(), csv.counts().refused)
        };
        let whole = of_pieces(text.len());
        for length in [1, 2, 7] {
            assert_eq!(of_pieces(length), whole);
        }
        whole
    }

    #[test]
    fn lines_are_read_with_a_header_in_any_order_or_without() {
        assert_eq!(
            times("gx,gy,gz,ax,ay,az,t_s\r\n0,0,0,0,0,9.8,-0.5\r\n\r\n0,0,0,0,0,nan,1\r\n"),
            (vec![-500_000_000, 1_000_000_000], 0)
        );
        assert_eq!(times("1,0,0,0,0,0,9.8\n2,0,0,0,0,0,9.8\n"), (vec![1_000_000_000, 2_000_000_000], 0));
        assert_eq!(times("1,0,0,0,0,0,9.8,20,0,40\n").0.len(), 1);
    }

    #[test]
    fn what_is_no_row_is_counted_and_the_next_is_found() {
        let text =
            "hello\nt_s,gx,gy,gz,ax,ay,az\n1,0,0,0,0,0,9.8\n2,0,0,x,0,0,9.8\n3,0,0\n\u{fffd}\n4,0,0,0,0,0,9.8\n5,0";
        assert_eq!(times(text), (vec![1_000_000_000, 4_000_000_000], 4));
        let endless = format!("{}\n1,0,0,0,0,0,9.8\n", "1".repeat(LINE_BYTES_MAX + 1));
        assert_eq!(times(&endless), (vec![1_000_000_000], 1));
    }

    #[test]
    fn another_header_counts_from_there_on() {
        let text = "t_s,gx,gy,gz,ax,ay,az\n1,0,0,0,0,0,9.8\ngx,gy,gz,ax,ay,az,t_s\n0,0,0,0,0,9.8,2\n";
        assert_eq!(times(text), (vec![1_000_000_000, 2_000_000_000], 0));
    }
}

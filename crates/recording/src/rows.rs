//! The rows of a text that comes line by line, as from a program that sends while it measures.

use csv::ByteRecord;

use crate::{
    columns::{self, Columns},
    error::Fault,
    reader::{Row, row},
    table::Fields,
};

/// Makes rows of lines under one header.
pub struct Rows {
    columns: Columns,
    names: Vec<&'static str>,
    record: ByteRecord,
}

impl Rows {
    /// For lines under this header.
    pub fn of_header(line: &[u8]) -> Result<Self, Fault> {
        let mut record = ByteRecord::new();
        split(line, &mut record);
        let names = columns::names(&record, 1, &Columns::KNOWN).map_err(|(_, fault)| fault)?;
        Ok(Self { columns: Columns::of(&names)?, names, record })
    }

    /// The row of a line; its end may be missing.
    pub fn row(&mut self, line: &[u8]) -> Result<Row, Fault> {
        split(line, &mut self.record);
        let fields = Fields { record: &self.record, names: &self.names, line: 1 };
        fields.check().and_then(|()| row(&fields, &self.columns)).map_err(|(_, fault)| fault)
    }
}

fn split(line: &[u8], record: &mut ByteRecord) {
    record.clear();
    line.split(|byte| *byte == b',').for_each(|field| record.push_field(field));
}

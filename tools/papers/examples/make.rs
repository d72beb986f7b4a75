//! Makes every paper: `cargo run --release -p papers --example make -- DIR`.

use std::{error::Error, path::PathBuf};

use papers::Paper;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("name a folder")?);
    let chosen = std::env::args().nth(2);
    for paper in Paper::ALL.into_iter().filter(|paper| chosen.as_deref().is_none_or(|name| name == paper.name())) {
        let made = papers::make(paper, &folder, &mut |done, of| eprint!("\r{} {done}/{of}", paper.name()))?;
        eprintln!();
        for part in &made.parts {
            println!("{}\n{}", part.title, part.about);
            if let papers::picture::Picture::Table(table) = &part.picture {
                println!("{table}");
            }
        }
        println!("{}", made.page.display());
    }
    Ok(())
}

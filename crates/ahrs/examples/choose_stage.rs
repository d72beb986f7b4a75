//! Chooses the fuser stage by type, by name, and with parameters.
use plumbline_ahrs::{
    Ahrs, BuildError, Slot,
    stages::{Fuser, Wz},
};

fn main() -> Result<(), BuildError> {
    // By type: the program contains only the code of this stage.
    let mut by_type = Ahrs::builder().fuser(Wz::default()).build();
    println!("{:?}", by_type.update([0.0; 3], [0.0, 1.0, 9.75], None, 0.01).angles());

    // By name: every stage can be chosen at run time.
    for name in Fuser::NAMES {
        let mut ahrs = Ahrs::with_stage(name)?;
        println!("{name}: {:?}", ahrs.update([0.0; 3], [0.0, 1.0, 9.75], None, 0.01).angles());
    }

    // With parameters: each has a unit, a range and a description.
    let builder = Ahrs::builder().fuser_stage("wz")?;
    for parameter in builder.parameters(Slot::Fuser) {
        println!("{} = {} {}", parameter.name, parameter.default, parameter.unit);
    }
    if let Err(error) = Ahrs::builder().fuser_stage("vfq") {
        println!("{error}");
    }
    Ok(())
}

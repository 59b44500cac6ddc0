//! What the runtime promises, checked on the workstation: against numbers from elsewhere, and as laws.

mod arm;
mod bound_laws;
mod chain_laws;
mod corrected;
mod deflection_laws;
mod elastic_model;
mod elastic_refuses;
mod folded;
mod gravity_reference;
mod json;
mod model_answers;
mod model_refuses;
mod newton_laws;
mod poe_laws;
mod poe_reference;
mod posterior_reference;
mod ripple_laws;
mod scalar;
mod se3_laws;
mod se3_reference;
mod se3_truth;
mod seeded;
mod service;
mod signature;
mod signed_blob;
mod trust;

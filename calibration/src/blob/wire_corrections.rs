//! Converts corrections to the form in which a blob stores them: numbers in `f32`, rows as bytes.

use heapless::Vec as FixedVec;
use poegp_protocol::blob::{CorrectionLimit, Elastic, JointKernel, Ripple, TaskSpace};
use poegp_runtime::kinematics::minimal_chain::MinimalForm;

use crate::learning::elastic::reduced_model::ElasticModel;
use crate::model::Calibration;
use crate::model::correction::TaskSpaceCorrection;

/// The error for a part of a model that the blob format cannot store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DoesNotFit(pub &'static str);

/// Collects `items` into a vector of fixed capacity; the error names `what` does not fit.
pub fn fixed<T, const N: usize>(
    items: impl IntoIterator<Item = T>,
    what: &'static str,
) -> Result<FixedVec<T, N>, DoesNotFit> {
    let mut out = FixedVec::new();
    for item in items {
        out.push(item).map_err(|_| DoesNotFit(what))?;
    }
    Ok(out)
}

/// Converts the task-space correction; returns it without its rows, and the bytes of the rows.
pub fn task_space(
    correction: &TaskSpaceCorrection,
    limit: CorrectionLimit,
) -> Result<(TaskSpace<'static>, Vec<u8>), DoesNotFit> {
    let (gp, (header, rows)) = (&correction.gp, &correction.posterior_mean);
    // Folds the rows into the form that takes the device less time, if the inducing points allow it.
    let (mut header, mut rows) = (*header, rows.clone());
    header.fold(&mut rows);
    let inputs = header.inputs;
    let hyperparameters = gp
        .hyperparameters
        .iter()
        .map(|h| h.to_array().map(|x| x as f32));
    let mut affine: [FixedVec<f32, 10>; 6] = Default::default();
    for (slots, values) in affine.iter_mut().zip(&header.affine) {
        *slots = fixed(
            values.iter().take(inputs + 1).map(|x| *x as f32),
            "affine map",
        )?;
    }
    let task_space = TaskSpace {
        limit,
        hyperparameters: fixed(hyperparameters, "hyperparameters")?,
        output_scale: gp.output_scale.map(|x| x as f32),
        input_scale: fixed(
            header.input_scale.iter().take(inputs).map(|x| *x as f32),
            "input scales",
        )?,
        rates: header.rates.map(|rates| rates.map(|x| x as f32)),
        affine,
        rows: &[],
        centre: match &header.centre {
            Some(centre) => fixed(centre.iter().take(inputs).map(|x| *x as f32), "centre")?,
            None => FixedVec::new(),
        },
        landmarks: 0,
        landmark_rows: &[],
    };
    Ok((task_space, little_endian(&rows)))
}

pub fn little_endian(rows: &[f64]) -> Vec<u8> {
    rows.iter()
        .flat_map(|x| (*x as f32).to_le_bytes())
        .collect()
}

/// Converts the elastic correction; returns it without its rows.
pub fn elastic(
    elastic: &ElasticModel,
    calibration: &Calibration,
    limit: CorrectionLimit,
) -> Result<Elastic<'static>, DoesNotFit> {
    let n = calibration.calibrated.kinds().len();
    let d = &elastic.deflection;
    let mut gravity = elastic.gravity;
    gravity.turn_into(&MinimalForm::new(&calibration.calibrated));
    let (gravity, processes) = (&gravity, &d.processes);
    let single = |v: &nalgebra::Vector3<f64>| [v[0] as f32, v[1] as f32, v[2] as f32];
    let links = (0..n).flat_map(|c| (c..n).map(move |j| single(&gravity.links[c][j])));
    let payload = (0..n).map(|c| {
        let offset = single(&gravity.payload_offset[c]);
        [
            gravity.payload_lever[c] as f32,
            offset[0],
            offset[1],
            offset[2],
        ]
    });
    let ripple = d.ripple.iter().map(|t| Ripple {
        joint: t.joint as u8,
        cycles: t.cycles as f32,
        sin: t.sin as f32,
        cos: t.cos as f32,
    });
    let mut kernels = FixedVec::new();
    if !elastic.rows_and_curves().0.is_empty() {
        for k in &processes.kernels[..n] {
            let kernel = JointKernel {
                rates: fixed(k.rates()[..n].iter().map(|x| *x as f32), "rates")?,
                payload_rate: k.payload_rate as f32,
                amplitude: k.amplitude as f32,
                payload_amplitude: k.payload_amplitude as f32,
            };
            kernels.push(kernel).map_err(|_| DoesNotFit("kernels"))?;
        }
    }
    let payloads = processes.group_payloads_kg.iter().map(|m| *m as f32);
    let count = processes.group_payloads_kg.len();
    let sets = processes
        .sets
        .iter()
        .map(|set| fixed(set.points()[..count].iter().copied(), "inducing sets"));
    let sets: Vec<_> = sets.collect::<Result<_, _>>()?;
    Ok(Elastic {
        limit,
        gravity: single(&gravity.gravity),
        links: fixed(links, "gravity terms")?,
        payload: fixed(payload, "payload terms")?,
        ripple: fixed(ripple, "gear ripple")?,
        curves: &[],
        kernels,
        group_payloads_kg: fixed(payloads, "payload groups")?,
        sets: fixed(sets, "inducing sets")?,
        rows: &[],
    })
}

"""Sobol' indices by us and by peers, from the same samples in the same run.

    pip install openturns egobox SALib
    python benchmarks/peers.py [--cases 5]

Ours: Kriging and projection; "own samples" are as many, chosen by `sensitivity`. Peers: OpenTURNS
GP and sparse polynomial chaos, egobox GP, and the paper's procedure: scikit-learn's own GP with
SALib's Saltelli estimator on its mean. The means of the other GPs are integrated by quadrature, so
that their errors are those of the GP; with more than four parameters they go through that estimator
too. "true f" is that estimator on the function itself. Processor time, one thread.
"""

import argparse
import time
import warnings

import egobox
import numpy as np
import openturns as ot
from SALib.analyze import sobol as salib_sobol
from SALib.sample import sobol as salib_sample
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from threadpoolctl import threadpool_limits

from excitation_planner import Box, Indices, Kriging, sensitivity, sobol_indices
from excitation_planner.indices.analytic import (
    MATH_MODEL_OPERATION,
    MATH_MODEL_UNKNOWN,
    g_function,
    g_function_indices,
    ishigami,
    ishigami_indices,
    math_model,
    quadrature_indices,
)
from excitation_planner.indices.sampling import training_points

SALTELLI = 2**14  # base samples of the estimator on a peer's mean


def ours(U, m):
    return sobol_indices(Kriging().fit(U, m))


def saltelli(predict, k):
    problem = {"num_vars": k, "names": [str(i) for i in range(k)], "bounds": [[0, 1]] * k}
    P = salib_sample.sample(problem, SALTELLI, calc_second_order=False, seed=0)
    values = np.concatenate([np.ravel(predict(part)) for part in np.array_split(P, 8)])
    found = salib_sobol.analyze(problem, values, calc_second_order=False, num_resamples=2)
    return Indices(main=found["S1"], total=found["ST"], variance=float(values.var()))


def of_mean(predict, k):
    """Indices of a peer's mean: by quadrature as long as it has few nodes."""
    if k > 4:
        return saltelli(predict, k)
    nodes = 12 if k == 4 else 20
    return quadrature_indices(lambda P: np.ravel(predict(P)), Box.of(unit(k)), nodes=nodes)


def scikit_learn(U, m):
    # with its default bounds the length scales collapse to 1e-5, and R² to 0
    kernel = ConstantKernel() * RBF(np.ones(U.shape[1]), (0.05, 50.0)) + WhiteKernel(
        1e-6, (1e-12, 1.0)
    )
    model = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0).fit(U, m)
    return saltelli(model.predict, U.shape[1])


def egobox_gp(U, m):
    model = egobox.Gpx.builder(corr_spec=egobox.CorrelationSpec.SQUARED_EXPONENTIAL).fit(U, m)
    return of_mean(model.predict, U.shape[1])


def openturns_gp(U, m):
    k = U.shape[1]
    covariance = ot.SquaredExponential([0.5] * k)
    fitter = ot.GaussianProcessFitter(
        ot.Sample(U), ot.Sample(m[:, None]), covariance, ot.ConstantBasisFactory(k).build()
    )
    fitter.run()
    regression = ot.GaussianProcessRegression(fitter.getResult())
    regression.run()
    mean = regression.getResult().getMetaModel()
    return of_mean(lambda P: np.asarray(mean(ot.Sample(P))), k)


def openturns_pce(U, m):
    k = U.shape[1]
    joint = ot.JointDistribution([ot.Uniform(0.0, 1.0)] * k)
    basis = ot.OrthogonalProductPolynomialFactory(
        [ot.LegendreFactory()] * k, ot.HyperbolicAnisotropicEnumerateFunction(k, 0.7)
    )
    selection = ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    algorithm = ot.FunctionalChaosAlgorithm(
        ot.Sample(U),
        ot.Sample(m[:, None]),
        joint,
        ot.FixedStrategy(basis, basis.getEnumerateFunction().getBasisSizeFromTotalDegree(8)),
        ot.LeastSquaresStrategy(selection),
    )
    algorithm.run()
    found = ot.FunctionalChaosSobolIndices(algorithm.getResult())
    return Indices(
        main=np.array([found.getSobolIndex(i) for i in range(k)]),
        total=np.array([found.getSobolTotalIndex(i) for i in range(k)]),
        variance=float("nan"),
    )


PEERS = {
    "ours": ours,
    "OpenTURNS GP": openturns_gp,
    "OpenTURNS sparse PCE": openturns_pce,
    "egobox GP": egobox_gp,
    "scikit-learn + SALib": scikit_learn,
}


def unit(k):
    return {f"p{i}": (0.0, 1.0) for i in range(k)}


def problems(cases):
    rng = np.random.default_rng(0)
    for _ in range(cases):
        x = MATH_MODEL_OPERATION.from_unit(rng.uniform(size=4))
        f = lambda U, x=x: math_model(x, U)  # noqa: E731
        yield "Eq. 13", 300, 4, f, quadrature_indices(f, MATH_MODEL_UNKNOWN)
    yield "Ishigami", 300, 3, lambda U: ishigami(np.pi * (2 * U - 1)), ishigami_indices()
    a = np.array([0.0, 1.0, 4.5, 9.0, 99, 99, 99, 99])
    yield "G function, k = 8", 400, 8, lambda U: g_function(U, a), g_function_indices(a)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=5, help="operating points of Eq. 13")
    cases = parser.parse_args().cases
    ot.Log.Show(ot.Log.NONE)
    ot.TBB.Disable()
    results = {}
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # peers' convergence warnings
        for seed, (problem, n, k, f, exact) in enumerate(problems(cases)):
            U = training_points(n, k, seed=seed)
            m = f(U)
            methods = PEERS | {
                "ours, own samples": lambda U, _, f=f: sensitivity(
                    f, unit(U.shape[1]), samples=len(U)
                ),
                "true f + SALib": lambda U, _, f=f: saltelli(f, U.shape[1]),
            }
            for peer, method in methods.items():
                start = time.process_time()
                found = method(U, m)
                error = max(
                    np.abs(found.main - exact.main).max(), np.abs(found.total - exact.total).max()
                )
                results.setdefault((problem, peer), []).append((error, time.process_time() - start))
    print(
        f"{'':18s} {'':22s} {'error median':>12s} {'worst':>9s} {'s':>7s}"
        f" {'error, of ours':>14s} {'time, of ours':>13s}"
    )
    for (problem, peer), found in results.items():
        error, seconds = np.median(found, axis=0)
        our_error, our_seconds = np.median(results[problem, "ours"], axis=0)
        print(
            f"{problem:18s} {peer:22s} {error:12.1e} {max(e for e, _ in found):9.1e}"
            f" {seconds:7.2f} {error / our_error:14.1f} {seconds / our_seconds:13.1f}"
        )


if __name__ == "__main__":
    main()

// Calls qpOASES and HPIPM on one dense QP and times them without Python: minimise ½ zᵀHz + gᵀz, lower ≤ Az ≤ upper.
//
// Workspaces are kept between calls of one shape, as herd keeps its own. The clock covers handing over the matrices,
// the cold solve and fetching z. A solver that fails returns a negative number of seconds.
#include <chrono>
#include <cstdlib>
#include <map>
#include <memory>
#include <utility>

#ifdef WITH_QPOASES
#include <qpOASES.hpp>
#endif
#ifdef WITH_HPIPM
extern "C" {
#include <blasfeo_common.h>
#include <hpipm_d_dense_qp.h>
#include <hpipm_d_dense_qp_dim.h>
#include <hpipm_d_dense_qp_ipm.h>
#include <hpipm_d_dense_qp_sol.h>
}
#endif

namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

}  // namespace

#ifdef WITH_QPOASES
// `H` and `A` row-major.
extern "C" double qpoases_solve(int n, int m, const double *H, const double *g, const double *A, const double *lower,
                                const double *upper, double *z) {
    static std::map<std::pair<int, int>, std::unique_ptr<qpOASES::QProblem>> problems;
    auto &problem = problems[{n, m}];
    if (!problem) {
        problem = std::make_unique<qpOASES::QProblem>(n, m, qpOASES::HST_POSDEF);
        qpOASES::Options options;
        options.setToMPC();
        options.printLevel = qpOASES::PL_NONE;
        problem->setOptions(options);
    }
    qpOASES::int_t changes = 1000;
    const auto start = Clock::now();
    problem->reset();
    problem->setHessianType(qpOASES::HST_POSDEF);
    const auto status = problem->init(H, g, A, nullptr, nullptr, lower, upper, changes);
    problem->getPrimalSolution(z);
    const double seconds = seconds_since(start);
    return status == qpOASES::SUCCESSFUL_RETURN ? seconds : -seconds;
}
#endif

#ifdef WITH_HPIPM
namespace {

// All that HPIPM wants to be given for one shape; lives as long as the process.
struct Hpipm {
    d_dense_qp_dim dim;
    d_dense_qp qp;
    d_dense_qp_sol solution;
    d_dense_qp_ipm_arg arg;
    d_dense_qp_ipm_ws workspace;

    Hpipm(int n, int m, hpipm_mode mode, double tolerance) {
        d_dense_qp_dim_create(&dim, room(d_dense_qp_dim_memsize()));
        d_dense_qp_dim_set_all(n, 0, 0, m, 0, 0, &dim);
        d_dense_qp_create(&dim, &qp, room(d_dense_qp_memsize(&dim)));
        d_dense_qp_sol_create(&dim, &solution, room(d_dense_qp_sol_memsize(&dim)));
        d_dense_qp_ipm_arg_create(&dim, &arg, room(d_dense_qp_ipm_arg_memsize(&dim)));
        d_dense_qp_ipm_arg_set_default(mode, &arg);
        int iterations = 100;
        d_dense_qp_ipm_arg_set_iter_max(&iterations, &arg);
        d_dense_qp_ipm_arg_set_tol_stat(&tolerance, &arg);
        d_dense_qp_ipm_arg_set_tol_eq(&tolerance, &arg);
        d_dense_qp_ipm_arg_set_tol_ineq(&tolerance, &arg);
        d_dense_qp_ipm_arg_set_tol_comp(&tolerance, &arg);
        d_dense_qp_ipm_ws_create(&dim, &arg, &workspace, room(d_dense_qp_ipm_ws_memsize(&dim, &arg)));
    }

    static void *room(std::size_t bytes) {
        return std::aligned_alloc(64, (bytes + 4096) / 64 * 64);
    }
};

}  // namespace

// `A` column-major; a bound that is no bound has 0 in its mask.
extern "C" double hpipm_solve(int n, int m, const double *H, const double *g, const double *A, const double *lower,
                              const double *upper, const double *lower_mask, const double *upper_mask,
                              double tolerance, double *z) {
    static std::map<std::pair<int, int>, std::unique_ptr<Hpipm>> solvers;
    auto &hpipm = solvers[{n, m}];
    if (!hpipm) {
        hpipm = std::make_unique<Hpipm>(n, m, SPEED, tolerance);
    }
    const auto start = Clock::now();
    d_dense_qp *qp = &hpipm->qp;
    d_dense_qp_set_H(const_cast<double *>(H), qp);
    d_dense_qp_set_g(const_cast<double *>(g), qp);
    d_dense_qp_set_C(const_cast<double *>(A), qp);
    d_dense_qp_set_lg(const_cast<double *>(lower), qp);
    d_dense_qp_set_ug(const_cast<double *>(upper), qp);
    d_dense_qp_set_lg_mask(const_cast<double *>(lower_mask), qp);
    d_dense_qp_set_ug_mask(const_cast<double *>(upper_mask), qp);
    d_dense_qp_ipm_solve(qp, &hpipm->solution, &hpipm->arg, &hpipm->workspace);
    int status = -1;
    d_dense_qp_ipm_get_status(&hpipm->workspace, &status);
    d_dense_qp_sol_get_v(&hpipm->solution, z);
    const double seconds = seconds_since(start);
    // MIN_STEP: no further progress in floating point; how good z is, its error tells.
    return status == SUCCESS || status == MIN_STEP ? seconds : -seconds;
}
#endif

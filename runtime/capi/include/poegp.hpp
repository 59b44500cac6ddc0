/* Calibrated robot arms for programs in C++17: a header-only wrapper of `poegp.h` whose types hold their memory.

   The template parameter is `float` or `double`. Nothing throws, nothing allocates, and every answer is bit for bit
   that of the underlying C function. poegp.h documents each function, unit and code. */
#ifndef POEGP_HPP
#define POEGP_HPP

#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "poegp.h"

namespace poegp {

/* A non-owning view of numbers of the caller, for one call: a std::array, an array, or a pointer and a count. */
template <class T>
class span {
  public:
    constexpr span() noexcept = default;
    constexpr span(T *start, std::size_t count) noexcept : start_(start), count_(count) {}
    template <std::size_t N>
    constexpr span(T (&values)[N]) noexcept : start_(values), count_(N) {}
    template <std::size_t N>
    constexpr span(std::array<std::remove_const_t<T>, N> &values) noexcept : start_(values.data()), count_(N) {}
    template <std::size_t N>
    constexpr span(const std::array<std::remove_const_t<T>, N> &values) noexcept : start_(values.data()), count_(N) {}
    constexpr T *data() const noexcept { return start_; }
    constexpr std::size_t size() const noexcept { return count_; }

  private:
    T *start_ = nullptr;
    std::size_t count_ = 0;
};

/* A rigid transform: a 3x4 matrix [R | t] in row-major order, translation in metres. */
template <class T>
using pose = std::array<T, 12>;

/* A non-owning view of a pose of the caller, or of none, for one call. */
template <class T>
class pose_view {
  public:
    constexpr pose_view() noexcept = default;
    constexpr pose_view(const pose<T> &rows) noexcept : rows_(rows.data()) {}
    constexpr pose_view(const T (&rows)[12]) noexcept : rows_(rows) {}
    constexpr const T *data() const noexcept { return rows_; }

  private:
    const T *rows_ = nullptr;
};

/* An answer and its code. The answer is safe to use whatever the code is; poegp.h states the answer for each error. */
template <class A>
struct [[nodiscard]] result {
    std::int32_t code;
    A answer;
    constexpr explicit operator bool() const noexcept { return code == POEGP_OK; }
    constexpr const A *operator->() const noexcept { return &answer; }
};

/* Returns the meaning of a code as text; never null. */
inline const char *error_text(std::int32_t code) noexcept { return poegp_error_text(code); }

namespace detail {

/* The C functions and types of one precision. */
template <class T>
struct api;

template <>
struct api<float> {
    using model = poegp_model_t;
    using filter = poegp_filter_t;
    using evaluation = poegp_evaluation_t;
    using corrected = poegp_corrected_t;
    using forward = poegp_forward_t;
    using inverse = poegp_inverse_t;
    using jacobian = poegp_jacobian_t;
    using settings = poegp_filter_settings_t;
    using commanded = poegp_commanded_t;
    static constexpr std::size_t model_bytes = POEGP_MODEL_BYTES;
    static constexpr std::size_t filter_bytes = POEGP_FILTER_BYTES;
    static constexpr auto init = &poegp_init;
    static constexpr auto load = &poegp_load;
    static constexpr auto load_signed = &poegp_load_signed;
    static constexpr auto identify = &poegp_identify;
    static constexpr auto evaluate = &poegp_evaluate;
    static constexpr auto correct = &poegp_correct;
    static constexpr auto to_pose = &poegp_forward;
    static constexpr auto to_joints = &poegp_inverse;
    static constexpr auto to_jacobian = &poegp_jacobian;
    static constexpr auto defaults = &poegp_filter_defaults;
    static constexpr auto filter_init = &poegp_filter_init;
    static constexpr auto command = &poegp_command;
    static constexpr auto disengaged = &poegp_filter_disengaged;
    static constexpr auto counts = &poegp_filter_counts;
    static constexpr auto reset = &poegp_filter_reset;
};

template <>
struct api<double> {
    using model = poegp_model_f64_t;
    using filter = poegp_filter_f64_t;
    using evaluation = poegp_evaluation_f64_t;
    using corrected = poegp_corrected_f64_t;
    using forward = poegp_forward_f64_t;
    using inverse = poegp_inverse_f64_t;
    using jacobian = poegp_jacobian_f64_t;
    using settings = poegp_filter_settings_f64_t;
    using commanded = poegp_commanded_f64_t;
    static constexpr std::size_t model_bytes = POEGP_MODEL_F64_BYTES;
    static constexpr std::size_t filter_bytes = POEGP_FILTER_F64_BYTES;
    static constexpr auto init = &poegp_init_f64;
    static constexpr auto load = &poegp_load_f64;
    static constexpr auto load_signed = &poegp_load_signed_f64;
    static constexpr auto identify = &poegp_identify_f64;
    static constexpr auto evaluate = &poegp_evaluate_f64;
    static constexpr auto correct = &poegp_correct_f64;
    static constexpr auto to_pose = &poegp_forward_f64;
    static constexpr auto to_joints = &poegp_inverse_f64;
    static constexpr auto to_jacobian = &poegp_jacobian_f64;
    static constexpr auto defaults = &poegp_filter_defaults_f64;
    static constexpr auto filter_init = &poegp_filter_init_f64;
    static constexpr auto command = &poegp_command_f64;
    static constexpr auto disengaged = &poegp_filter_disengaged_f64;
    static constexpr auto counts = &poegp_filter_counts_f64;
    static constexpr auto reset = &poegp_filter_reset_f64;
};

} // namespace detail

template <class T>
using evaluation = typename detail::api<T>::evaluation;
template <class T>
using corrected = typename detail::api<T>::corrected;
template <class T>
using forward = typename detail::api<T>::forward;
template <class T>
using inverse = typename detail::api<T>::inverse;
template <class T>
using jacobian = typename detail::api<T>::jacobian;
template <class T>
using commanded = typename detail::api<T>::commanded;
template <class T>
using filter_settings = typename detail::api<T>::settings;

/* Memory for one model or one filter. */
template <class T>
struct model_memory {
    alignas(POEGP_MODEL_ALIGN) unsigned char bytes[detail::api<T>::model_bytes];
};
template <class T>
struct filter_memory {
    alignas(POEGP_FILTER_ALIGN) unsigned char bytes[detail::api<T>::filter_bytes];
};

/* A model in memory of the caller, which must outlive the model. */
template <class T>
class borrowed_model {
    static_assert(std::is_same_v<T, float> || std::is_same_v<T, double>, "float or double");
    using api = detail::api<T>;

  public:
    explicit borrowed_model(model_memory<T> &memory) noexcept : borrowed_model(memory.bytes, sizeof memory.bytes) {}
    borrowed_model(void *memory, std::size_t bytes) noexcept
        : code_(poegp_api_version() == POEGP_API_VERSION ? api::init(memory, bytes, &handle_) : POEGP_ERROR_OTHER)
    {
    }
    borrowed_model(const borrowed_model &) = delete;
    borrowed_model &operator=(const borrowed_model &) = delete;

    /* Returns POEGP_OK, or why there is no model; every later call then returns POEGP_ERROR_NULL. POEGP_ERROR_OTHER:
       the API version of the library differs from that of the header. */
    [[nodiscard]] std::int32_t code() const noexcept { return code_; }

    /* Loads a blob, all or nothing. Do not call it while another thread uses the model. */
    [[nodiscard]] std::int32_t load(span<const std::uint8_t> blob) noexcept
    {
        return api::load(handle_, blob.data(), blob.size());
    }
    [[nodiscard]] std::int32_t load_signed(span<const std::uint8_t> blob,
                                           const std::array<std::uint8_t, 32> &public_key) noexcept
    {
        return api::load_signed(handle_, blob.data(), blob.size(), public_key.data());
    }

    result<poegp_identity_t> identify() const noexcept
    {
        result<poegp_identity_t> out;
        out.code = api::identify(handle_, &out.answer);
        return out;
    }
    /* In this and all later functions, joints are in rad or m and the payload is in kg. */
    result<evaluation<T>> evaluate(span<const T> joints, T payload_kg) const noexcept
    {
        result<evaluation<T>> out;
        out.code = api::evaluate(handle_, joints.data(), joints.size(), payload_kg, &out.answer);
        return out;
    }
    result<corrected<T>> correct(span<const T> joints, T payload_kg) const noexcept
    {
        result<corrected<T>> out;
        out.code = api::correct(handle_, joints.data(), joints.size(), payload_kg, &out.answer);
        return out;
    }
    /* Without `target_from_tool`, this and the next two functions refer to the target that was measured. */
    result<poegp::forward<T>> forward(span<const T> joints, T payload_kg,
                                      pose_view<T> target_from_tool = {}) const noexcept
    {
        result<poegp::forward<T>> out;
        out.code = api::to_pose(handle_, target_from_tool.data(), joints.data(), joints.size(), payload_kg, &out.answer);
        return out;
    }
    result<poegp::inverse<T>> inverse(pose_view<T> base_from_tool, span<const T> seed, T payload_kg,
                                      pose_view<T> target_from_tool = {}) const noexcept
    {
        result<poegp::inverse<T>> out;
        out.code = api::to_joints(handle_, target_from_tool.data(), base_from_tool.data(), seed.data(), seed.size(),
                                  payload_kg, &out.answer);
        return out;
    }
    result<poegp::jacobian<T>> jacobian(span<const T> joints, T payload_kg,
                                        pose_view<T> target_from_tool = {}) const noexcept
    {
        result<poegp::jacobian<T>> out;
        out.code =
            api::to_jacobian(handle_, target_from_tool.data(), joints.data(), joints.size(), payload_kg, &out.answer);
        return out;
    }

    /* Returns the pointer for the C functions; null if there is no model. */
    typename api::model *handle() noexcept { return handle_; }
    const typename api::model *handle() const noexcept { return handle_; }

  private:
    typename api::model *handle_ = nullptr;
    std::int32_t code_;
};

/* A model that holds its memory, 27 or 54 kB: make it static, or a member of an object that is not on the stack. */
template <class T>
class model : private model_memory<T>, public borrowed_model<T> {
  public:
    model() noexcept : borrowed_model<T>(static_cast<model_memory<T> &>(*this)) {}
};

/* Returns the default settings for a time of `period_s` seconds between two commands. */
template <class T>
inline filter_settings<T> usual_settings(T period_s) noexcept
{
    filter_settings<T> out{};
    (void)detail::api<T>::defaults(period_s, &out);
    return out;
}

/* A filter in memory of the caller, which must outlive the filter. It belongs to one arm and one thread. */
template <class T>
class borrowed_filter {
    using api = detail::api<T>;

  public:
    borrowed_filter(filter_memory<T> &memory, const filter_settings<T> &settings) noexcept
        : code_(api::filter_init(memory.bytes, sizeof memory.bytes, &settings, &handle_))
    {
    }
    borrowed_filter(const borrowed_filter &) = delete;
    borrowed_filter &operator=(const borrowed_filter &) = delete;

    /* Returns POEGP_OK, or why there is no filter. */
    [[nodiscard]] std::int32_t code() const noexcept { return code_; }

    /* Returns the joints to send, which never step. Call it once in every cycle. */
    result<commanded<T>> command(const borrowed_model<T> &model, span<const T> joints, T payload_kg, bool engage,
                                 std::uint32_t cycles = 1) noexcept
    {
        result<commanded<T>> out;
        out.code = api::command(model.handle(), handle_, joints.data(), joints.size(), payload_kg, engage ? 1 : 0, cycles,
                                &out.answer);
        return out;
    }
    [[nodiscard]] bool disengaged() const noexcept { return api::disengaged(handle_) != 0; }
    result<poegp_filter_counts_t> counts() const noexcept
    {
        result<poegp_filter_counts_t> out;
        out.code = api::counts(handle_, &out.answer);
        return out;
    }
    std::int32_t reset() noexcept { return api::reset(handle_); }

  private:
    typename api::filter *handle_ = nullptr;
    std::int32_t code_;
};

/* A filter that holds its memory. */
template <class T>
class filter : private filter_memory<T>, public borrowed_filter<T> {
  public:
    explicit filter(const filter_settings<T> &settings) noexcept
        : borrowed_filter<T>(static_cast<filter_memory<T> &>(*this), settings)
    {
    }
};

} // namespace poegp

#endif /* POEGP_HPP */

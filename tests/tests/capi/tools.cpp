// The path of tools.c with poegp.hpp, in both precisions.
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <type_traits>

#include "poegp.hpp"

// They can be neither copied nor moved, because the C functions hold their address. No destructor has anything to do.
static_assert(!std::is_copy_constructible_v<poegp::model<double>> && !std::is_move_constructible_v<poegp::model<double>>);
static_assert(!std::is_copy_constructible_v<poegp::filter<float>> && !std::is_move_constructible_v<poegp::filter<float>>);
static_assert(std::is_trivially_destructible_v<poegp::model<float>> && std::is_nothrow_default_constructible_v<poegp::model<float>>);

static std::uint8_t blob[65536];
static std::size_t blob_bytes;

template <class T>
static void print_bits(const T *values, std::size_t count)
{
    for (std::size_t i = 0; i < count; i++) {
        std::conditional_t<std::is_same_v<T, float>, std::uint32_t, std::uint64_t> bits;
        std::memcpy(&bits, &values[i], sizeof bits);
        std::printf(" %0*llx", static_cast<int>(2 * sizeof bits), static_cast<unsigned long long>(bits));
    }
}

template <class T>
static void question(const char *verb, const T *joints, const T *more, std::size_t count)
{
    const T payload_kg = 2;
    std::printf("%s", verb);
    print_bits(joints, 6);
    print_bits(&payload_kg, 1);
    print_bits(more, count);
}

template <class T>
static int path(poegp::borrowed_model<T> &model)
{
    const poegp::pose<T> tool = {0, -1, 0, T(0.05), 1, 0, 0, T(-0.1), 0, 0, 1, T(0.2)};
    if (model.code() != POEGP_OK || model.load({blob, blob_bytes}) != POEGP_OK) {
        return 1;
    }
    static poegp::filter<T> filter(poegp::usual_settings<T>(T(0.01)));
    const std::array<T, 6> start = {T(0.3), T(-0.2), T(0.4), T(0.1), T(0.7), T(-0.5)};
    std::array<T, 6> seed = start;
    std::printf("precision %d\n", static_cast<int>(8 * sizeof(T)));
    for (int cycle = 0; cycle < 100; cycle++) {
        std::array<T, 6> joints = start;
        for (std::size_t i = 0; i < 6; i++) {
            joints[i] += (i % 2 == 0 ? T(1) : T(-1)) * T(cycle) / T(1024);
        }

        const auto forward = model.forward(joints, T(2), tool);
        question<T>("forward", joints.data(), nullptr, 0);
        std::printf(" | %d %u", static_cast<int>(forward.code), static_cast<unsigned>(forward->status));
        print_bits(forward->base_from_tool, 12);
        print_bits(&forward->trust, 1);
        std::printf("\n");

        const auto jacobian = model.jacobian(joints, T(2), tool);
        question<T>("jacobian", joints.data(), nullptr, 0);
        std::printf(" | %d %u", static_cast<int>(jacobian.code), static_cast<unsigned>(jacobian->status));
        for (const auto &row : jacobian->rows) {
            print_bits(row, POEGP_MAX_JOINTS);
        }
        std::printf("\n");

        const auto inverse = model.inverse(forward->base_from_tool, seed, T(2), tool);
        question<T>("inverse", seed.data(), forward->base_from_tool, 12);
        std::printf(" | %d %u", static_cast<int>(inverse.code), static_cast<unsigned>(inverse->status));
        print_bits(inverse->joints, POEGP_MAX_JOINTS);
        print_bits(&inverse->position_error, 1);
        print_bits(&inverse->rotation_error, 1);
        std::printf("\n");
        std::memcpy(seed.data(), inverse->joints, sizeof seed);

        const auto corrected = model.correct(joints, T(2));
        question<T>("correct", joints.data(), nullptr, 0);
        std::printf(" | %d %u", static_cast<int>(corrected.code), static_cast<unsigned>(corrected->status));
        print_bits(corrected->joints, POEGP_MAX_JOINTS);
        print_bits(&corrected->applied, 1);
        print_bits(&corrected->position_error, 1);
        print_bits(&corrected->rotation_error, 1);
        std::printf("\n");

        const auto commanded = filter.command(model, joints, T(2), true);
        question<T>("command", joints.data(), nullptr, 0);
        std::printf(" | %d %u", static_cast<int>(commanded.code), static_cast<unsigned>(commanded->status));
        print_bits(commanded->joints, POEGP_MAX_JOINTS);
        print_bits(&commanded->weight, 1);
        std::printf("\n");
    }
    // Without a tool the pose is the target's, and the handle is one of the C interface.
    const T pointer_joints[6] = {start[0], start[1], start[2], start[3], start[4], start[5]};
    const auto bare = model.forward(pointer_joints, T(2));
    const auto target = model.evaluate({start.data(), 6}, T(2));
    const bool same = std::memcmp(bare->base_from_tool, target->base_from_target, sizeof bare->base_from_tool) == 0;
    const auto counts = filter.counts();
    const bool counted = counts && counts->held == 0 && !filter.disengaged() && filter.reset() == POEGP_OK;
    return same && counted && model.identify()->joints == 6 && model.handle() != nullptr ? 0 : 2;
}

int main(int count, char **arguments)
{
    std::FILE *file = count == 2 ? std::fopen(arguments[1], "rb") : nullptr;
    if (file == nullptr) {
        return 3;
    }
    blob_bytes = std::fread(blob, 1, sizeof blob, file);
    std::fclose(file);

    static poegp::model<float> single;
    static poegp::model_memory<double> memory;
    poegp::borrowed_model<double> lent(memory);
    const int failed = path(single) + path<double>(lent);

    // Memory that is too small is refused with a code, and the answers are safe.
    unsigned char small[64];
    poegp::borrowed_model<double> none(small, sizeof small);
    const std::array<double, 6> joints = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6};
    const auto refused = none.inverse(poegp::pose<double>{}, joints, 1.0);
    std::printf("none %d %d %d %.1f %s\n", static_cast<int>(none.code() != POEGP_OK), static_cast<int>(refused.code),
                static_cast<int>(static_cast<bool>(refused)), refused->joints[5], poegp::error_text(refused.code));
    return failed;
}

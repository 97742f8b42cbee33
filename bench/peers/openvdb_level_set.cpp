// Narrow-band level set of a triangle mesh by OpenVDB: times of several calls, and values at voxels that are asked for.
//
//     openvdb_level_set MESH RESULT CALLS
//
// MESH: int32 vertices, int32 faces, float64 voxel size, float64 origin[3], float64 half width in voxels, int32 voxels
// asked for; float32 vertices (V,3), int32 faces (F,3), int32 voxels (N,3). RESULT: float64 seconds of each call, and
// float64 processor seconds; float64 active voxels, float64 bytes of the grid, float64 bytes that the process had more at
// its highest than before the calls; float32 values (N). Little-endian.
#include <openvdb/openvdb.h>
#include <openvdb/tools/MeshToVolume.h>

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

template <typename T>
std::vector<T> take(std::istream& in, size_t count) {
    std::vector<T> found(count);
    in.read(reinterpret_cast<char*>(found.data()), count * sizeof(T));
    return found;
}

// A line of /proc/self/status, in bytes.
double status(const std::string& name) {
    std::ifstream in("/proc/self/status");
    for (std::string line; std::getline(in, line);)
        if (line.rfind(name + ":", 0) == 0) return 1024 * std::atof(line.c_str() + name.size() + 1);
    return 0;
}

int main(int argc, char** argv) {
    if (argc != 4) {
        std::cerr << "usage: openvdb_level_set MESH RESULT CALLS\n";
        return 2;
    }
    openvdb::initialize();
    std::ifstream in(argv[1], std::ios::binary);
    const auto sizes = take<int32_t>(in, 2);
    const auto numbers = take<double>(in, 5);
    const auto asked = take<int32_t>(in, 1)[0];
    const auto xyz = take<float>(in, 3 * size_t(sizes[0]));
    const auto faces = take<int32_t>(in, 3 * size_t(sizes[1]));
    const auto voxels = take<int32_t>(in, 3 * size_t(asked));
    if (!in) {
        std::cerr << "the mesh file is too short\n";
        return 1;
    }
    std::vector<openvdb::Vec3s> points(sizes[0]);
    for (size_t i = 0; i < points.size(); ++i) points[i] = {xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]};
    std::vector<openvdb::Vec3I> triangles(sizes[1]);
    for (size_t i = 0; i < triangles.size(); ++i)
        triangles[i] = {uint32_t(faces[3 * i]), uint32_t(faces[3 * i + 1]), uint32_t(faces[3 * i + 2])};
    const auto place = openvdb::math::Transform::createLinearTransform(numbers[0]);
    place->postTranslate({numbers[1], numbers[2], numbers[3]});

    openvdb::FloatGrid::Ptr grid;
    std::vector<double> result;
    const double before = status("VmRSS");
    for (int call = 0; call < std::atoi(argv[3]); ++call) {
        grid.reset();
        const auto begin = std::chrono::steady_clock::now();
        const auto ticks = std::clock();
        grid = openvdb::tools::meshToLevelSet<openvdb::FloatGrid>(*place, points, triangles, float(numbers[4]));
        result.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
        result.push_back(double(std::clock() - ticks) / CLOCKS_PER_SEC);
    }
    result.push_back(double(grid->activeVoxelCount()));
    result.push_back(double(grid->memUsage()));
    result.push_back(status("VmHWM") - before);
    auto reader = grid->getConstAccessor();
    std::vector<float> values(asked);
    for (int i = 0; i < asked; ++i)
        values[i] = reader.getValue({voxels[3 * i], voxels[3 * i + 1], voxels[3 * i + 2]});
    std::ofstream out(argv[2], std::ios::binary);
    out.write(reinterpret_cast<const char*>(result.data()), result.size() * sizeof(double));
    out.write(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float));
    return out ? 0 : 1;
}

//! The three headers as a static library for Zig programs, and as an include path for their own C files.
//!
//!     const softbody = b.dependency("softbody", .{ .target = target, .optimize = optimize });
//!     exe.root_module.linkLibrary(softbody.artifact("softbody"));     // brings the headers along
const std = @import("std");

pub fn build(b: *std.Build) void {
    const target = b.standardTargetOptions(.{});
    const optimize = b.standardOptimizeOption(.{});
    const library = b.addLibrary(.{
        .name = "softbody",
        .linkage = .static,
        .root_module = b.createModule(.{ .target = target, .optimize = optimize, .link_libc = true }),
    });
    library.root_module.addIncludePath(b.path("."));
    library.root_module.addCSourceFile(.{ .file = b.path("examples/shared/softbody.c"), .flags = &.{"-std=c99"} });
    for ([_][]const u8{ "softbody.h", "needle.h", "register.h" }) |header|
        library.installHeader(b.path(header), header);
    b.installArtifact(library);
}

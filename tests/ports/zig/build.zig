const std = @import("std");

pub fn build(b: *std.Build) void {
    const target = b.standardTargetOptions(.{});
    const optimize = b.standardOptimizeOption(.{});
    const softbody = b.dependency("softbody", .{ .target = target, .optimize = optimize });
    const app = b.addExecutable(.{
        .name = "app",
        .root_module = b.createModule(.{ .target = target, .optimize = optimize, .link_libc = true }),
    });
    app.root_module.addCSourceFile(.{ .file = b.path("app.c"), .flags = &.{"-DAPP_LIBRARY"} });
    app.root_module.linkLibrary(softbody.artifact("softbody"));
    b.installArtifact(app);
}

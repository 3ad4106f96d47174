// What a program in C# wants of a body: made from a mesh, stepped, read without copies of its own. Unity and .NET alike.
using System;
using System.Runtime.InteropServices;
using System.Text;

namespace Softbody
{
/// <summary>A call that failed: its result and what the library says of it.</summary>
public sealed class SoftbodyException : Exception
{
    public readonly sb_result Result;
    public SoftbodyException(sb_result result, string message) : base(result + ": " + message) { Result = result; }
}

/// <summary>A mesh and a body on it. One thread at a time. Units are SI.</summary>
public sealed unsafe class Organ : IDisposable
{
    sb_mesh* mesh;
    sb_body* body;

    /// <summary>From a volume mesh's file; scale 0.001 for millimetres. "" makes a liver-like organ.</summary>
    public Organ(string path, double scale, double young, double poisson, double density, sb_vec3 gravity)
    {
        sb_error error;
        mesh = (sb_mesh*)Marshal.AllocHGlobal(sizeof(sb_mesh));
        *mesh = new sb_mesh();
        try
        {
            Load(path, scale);
            sb_body_def def = Native.sb_default_body_def();
            sb_body* made;
            def.mesh = mesh;
            def.material = Native.sb_material_corotated(young, poisson, density);
            def.gravity = gravity;
            Check(Native.sb_body_create(&def, &made, &error), &error);
            body = made;
        }
        catch
        {
            Dispose();
            throw;
        }
    }

    void Load(string path, double scale)
    {
        sb_error error;
        if (path.Length == 0)
        {
            Check(Native.sb_mesh_organ(sb_element_type.SB_TET4, 12, null, mesh, &error), &error);
            return;
        }
        sb_load_options options = Native.sb_default_load_options();
        options.scale = scale;
        fixed (byte* name = Encoding.UTF8.GetBytes(path + "\0"))
            Check(Native.sb_mesh_load(mesh, name, &options, &error), &error);
    }

    public static void Check(sb_result result, sb_error* error)
    {
        if (result != sb_result.SB_OK)
            throw new SoftbodyException(result, Marshal.PtrToStringAnsi((IntPtr)error->message));
    }

    public void Dispose()
    {
        if (body != null)
            Native.sb_body_destroy(body);
        body = null;
        if (mesh != null)
        {
            Native.sb_mesh_free(mesh);
            Marshal.FreeHGlobal((IntPtr)mesh);
        }
        mesh = null;
        GC.SuppressFinalize(this);
    }
    ~Organ() { Dispose(); }

    /// <summary>For calls of Native that are not wrapped here.</summary>
    public sb_body* Body { get { return body; } }
    public int NodeCount { get { return Native.sb_body_node_count(body); } }
    /// <summary>[NodeCount] at rest (m).</summary>
    public sb_vec3* RestPositions { get { return mesh->nodes; } }
    /// <summary>[NodeCount] now (m): the library's own memory, new values after each step.</summary>
    public sb_vec3* Positions { get { return Native.sb_body_positions(body); } }
    /// <summary>[NodeCount] forces of supports on the body (N).</summary>
    public sb_vec3* Reactions { get { return Native.sb_body_reactions(body); } }

    /// <summary>Holds nodes where they are.</summary>
    public void Hold(int[] nodes)
    {
        sb_error error;
        fixed (int* first = nodes)
            Check(Native.sb_body_hold(body, first, nodes.Length, Native.SB_XYZ, &error), &error);
    }

    /// <summary>The next step takes the nodes to these places (m).</summary>
    public void Place(int[] nodes, sb_vec3[] places)
    {
        sb_error error;
        if (nodes.Length != places.Length)
            throw new ArgumentException("as many places as nodes");
        fixed (int* first = nodes)
        fixed (sb_vec3* where = places)
            Check(Native.sb_body_place(body, first, nodes.Length, Native.SB_XYZ, where, &error), &error);
    }

    public void Release(int[] nodes)
    {
        sb_error error;
        fixed (int* first = nodes)
            Check(Native.sb_body_release(body, first, nodes.Length, Native.SB_XYZ, &error), &error);
    }

    /// <summary>False where the step failed: the body is then as before it, and message says why.</summary>
    public bool Step(double dt, out string message)
    {
        sb_step_info info;
        sb_result result = Native.sb_body_step(body, dt, &info);
        message = result == sb_result.SB_OK ? "" : Marshal.PtrToStringAnsi((IntPtr)info.error.message);
        return result == sb_result.SB_OK;
    }

    /// <summary>Outside triangles, three node indices each.</summary>
    public int[] Triangles()
    {
        sb_error error;
        sb_boundary boundary;
        Check(Native.sb_mesh_boundary(mesh, 0, null, &boundary, &error), &error);
        int[] corners = new int[3 * boundary.surface.element_count];
        Marshal.Copy((IntPtr)boundary.surface.elements, corners, 0, corners.Length);
        Native.sb_boundary_free(&boundary);
        return corners;
    }
}
}

// Drives what C# has: the hash of native.c, errors, and Unity's component by a stub of Unity.
using System;
using System.Reflection;
using Softbody;
using UnityEngine;

static unsafe class Drive
{
    static void Require(bool fine, string what)
    {
        if (!fine)
            throw new Exception(what);
    }
    static void Call(object thing, string name)
    {
        thing.GetType().GetMethod(name, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(thing, null);
    }

    static void Main(string[] arguments)
    {
        sb_vec3 down;
        down.x = down.y = 0;
        down.z = -9.81;
        using (Organ organ = new Organ("", 1, 8000, 0.45, 1060, down))
        {
            string message;
            organ.Hold(new[] { 0, 7, 100 });
            for (int frame = 0; frame < 10; frame++)
                Require(organ.Step(1.0 / 60, out message), message);
            Require(Native.sb_body_state_hash(organ.Body).ToString() == arguments[0], "other bits than in C");
            Require(!organ.Step(-1, out message) && message.Length > 0, "a step of -1 s");
        }
        try
        {
            new Organ("nowhere.vtk", 1, 8000, 0.45, 1060, down);
            Require(false, "a file that is not there");
        }
        catch (SoftbodyException error)
        {
            Require(error.Result == sb_result.SB_ERROR_FILE, error.Message);
        }

        OrganBehaviour scene = new OrganBehaviour();
        Call(scene, "Start");
        Mesh drawn = scene.GetComponent<MeshFilter>().mesh;
        int corner = drawn.triangles[0];
        Vector3 rest = drawn.vertices[corner];
        scene.grasper = new Transform { position = rest };
        for (int frame = 0; frame < 5; frame++)
        {
            scene.grasper.position = new Vector3(rest.x, rest.y + 0.001f * frame, rest.z);
            Call(scene, "FixedUpdate");
        }
        Require((drawn.vertices[corner] - scene.grasper.position).magnitude < 1e-6f, "the grasper holds its node");
        Call(scene, "OnDestroy");
        Console.WriteLine("fine");
    }
}

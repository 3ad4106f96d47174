// Unity: an organ that moves the mesh of its GameObject. Put softbody.dll (or libsoftbody.so, libsoftbody.dylib) into
// Assets/Plugins, Softbody.cs, Organ.cs and this file into Assets, allow unsafe code (Player settings), and add the
// component to an empty GameObject with a material. README.md has the steps.
using Softbody;
using UnityEngine;

[RequireComponent(typeof(MeshFilter), typeof(MeshRenderer))]
public class OrganBehaviour : MonoBehaviour
{
    public string meshFile = "";        // in StreamingAssets; empty: a generated organ
    public float scale = 1;             // 0.001: the file is in millimetres
    public float young = 8000;          // Pa
    public float poisson = 0.45f;
    public float density = 1060;        // kg/m^3
    [Range(0, 1)] public float held = 0.33f; // share of its depth that is held, from the back
    public Transform grasper;           // pulls the node that is nearest when it comes within reach; inactive: lets go
    public float reach = 0.01f;         // m

    Organ organ;
    Mesh drawn;
    Vector3[] vertices;
    int grasped = -1;
    bool holds;

    // Unity's y points up and its frame is left-handed: z of the library is up, so y and z change places.
    static Vector3 ToUnity(sb_vec3 v) { return new Vector3((float)v.x, (float)v.z, (float)v.y); }
    static sb_vec3 FromUnity(Vector3 v)
    {
        sb_vec3 r;
        r.x = v.x;
        r.y = v.z;
        r.z = v.y;
        return r;
    }

    unsafe void Start()
    {
        string path = meshFile.Length > 0 ? System.IO.Path.Combine(Application.streamingAssetsPath, meshFile) : "";
        organ = new Organ(path, scale, young, poisson, density, FromUnity(Physics.gravity));
        double low = double.MaxValue, high = double.MinValue;
        for (int i = 0; i < organ.NodeCount; i++)
        {
            low = System.Math.Min(low, organ.RestPositions[i].y);
            high = System.Math.Max(high, organ.RestPositions[i].y);
        }
        var back = new System.Collections.Generic.List<int>();
        for (int i = 0; i < organ.NodeCount; i++)
            if (organ.RestPositions[i].y > high - held * (high - low))
                back.Add(i);
        organ.Hold(back.ToArray());
        vertices = new Vector3[organ.NodeCount];
        drawn = new Mesh();
        drawn.MarkDynamic();
        Draw();
        int[] corners = organ.Triangles(); // two axes change places, so triangles face the other way round
        for (int t = 0; t < corners.Length; t += 3)
        {
            int corner = corners[t + 1];
            corners[t + 1] = corners[t + 2];
            corners[t + 2] = corner;
        }
        drawn.triangles = corners;
        drawn.RecalculateNormals();
        GetComponent<MeshFilter>().mesh = drawn;
    }

    unsafe void FixedUpdate()
    {
        string message;
        Grasp();
        if (!organ.Step(Time.fixedDeltaTime, out message)) // undone: the organ is as before, and goes on
            Debug.LogWarning(message);
        Draw();
        drawn.RecalculateNormals();
        drawn.RecalculateBounds();
    }

    unsafe void Grasp()
    {
        bool on = grasper != null && grasper.gameObject.activeInHierarchy;
        if (!on)
        {
            if (grasped >= 0)
                organ.Release(new[] { grasped });
            grasped = -1;
            holds = false;
            return;
        }
        Vector3 tip = transform.InverseTransformPoint(grasper.position);
        float nearest = reach;
        for (int i = 0; !holds && i < vertices.Length; i++)
        {
            float distance = (vertices[i] - tip).magnitude;
            if (distance >= nearest)
                continue;
            nearest = distance;
            grasped = i;
        }
        holds = grasped >= 0;
        if (holds)
            organ.Place(new[] { grasped }, new[] { FromUnity(tip) });
    }

    unsafe void Draw()
    {
        sb_vec3* now = organ.Positions;
        for (int i = 0; i < vertices.Length; i++)
            vertices[i] = ToUnity(now[i]);
        drawn.vertices = vertices;
    }

    void OnDestroy()
    {
        if (organ != null)
            organ.Dispose();
    }
}

// What OrganBehaviour.cs uses of Unity, for the tests to compile and drive it.
using System;

namespace UnityEngine
{
[AttributeUsage(AttributeTargets.Class)] public class RequireComponent : Attribute
{
    public RequireComponent(Type a, Type b) { }
}
[AttributeUsage(AttributeTargets.Field)] public class RangeAttribute : Attribute
{
    public RangeAttribute(float low, float high) { }
}
public struct Vector3
{
    public float x, y, z;
    public Vector3(float x, float y, float z)
    {
        this.x = x;
        this.y = y;
        this.z = z;
    }
    public float magnitude { get { return (float)Math.Sqrt(x * x + y * y + z * z); } }
    public static Vector3 operator -(Vector3 a, Vector3 b) { return new Vector3(a.x - b.x, a.y - b.y, a.z - b.z); }
}
public class Mesh
{
    public Vector3[] vertices;
    public int[] triangles;
    public void MarkDynamic() { }
    public void RecalculateNormals() { }
    public void RecalculateBounds() { }
}
public class MeshFilter
{
    public Mesh mesh;
}
public class MeshRenderer { }
public class GameObject
{
    public bool activeInHierarchy = true;
}
public class Transform
{
    public Vector3 position;
    public GameObject gameObject = new GameObject();
    public Vector3 InverseTransformPoint(Vector3 point) { return point; }
}
public class MonoBehaviour
{
    public Transform transform = new Transform();
    readonly MeshFilter filter = new MeshFilter();
    public T GetComponent<T>() where T : class { return filter as T; }
}
public static class Physics
{
    public static Vector3 gravity = new Vector3(0, -9.81f, 0);
}
public static class Time
{
    public static float fixedDeltaTime = 1f / 60;
}
public static class Application
{
    public static string streamingAssetsPath = ".";
}
public static class Debug
{
    public static void LogWarning(string message) { Console.WriteLine(message); }
}
}
